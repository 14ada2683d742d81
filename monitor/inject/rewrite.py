"""Rewrites signals in an ECU's frames, for any DBC and map, and repairs counter and checksum.

Only the bits of the signal, the counter and the checksum change. An unsound frame (wrong length or
checksum) must not be rewritten: the repair would hide its defect.
"""

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

from monitor.decode.bus_map import BusChannel
from monitor.decode.checksum import payload_checksum
from monitor.decode.plan import multiplexing
from monitor.decode.raw_values import bit_position, last_byte, not_available_raw, raw_limits
from monitor.decode.signal_map import Integrity

Key = tuple[int, bool]  # identifier, whether it has 29 bits
_FLOATS: Final = {16: struct.Struct("<e"), 32: struct.Struct("<f"), 64: struct.Struct("<d")}


class PayloadField:
    """The place of one signal's raw value in a payload."""

    def __init__(self, channel: BusChannel, signal_name: str) -> None:
        message = channel.message
        signal = message.get_signal_by_name(signal_name)
        self._order = "little" if signal.byte_order == "little_endian" else "big"
        self._length = message.length
        self._position = bit_position(message, signal)
        self.bits = int(signal.length)
        self.mask = (1 << self.bits) - 1
        self.last_byte = last_byte(message, signal)

    def get(self, data: bytes) -> int:
        """Return the unsigned raw value; missing bytes of a short payload count as 0."""
        word = int.from_bytes(data.ljust(self._length, b"\0"), self._order)  # type: ignore[arg-type]
        return word >> self._position & self.mask

    def set(self, data: bytes, raw: int) -> bytes:
        """Return the payload with this raw value; its length stays."""
        order = self._order
        word = int.from_bytes(data.ljust(self._length, b"\0"), order)  # type: ignore[arg-type]
        word = word & ~(self.mask << self._position) | (raw & self.mask) << self._position
        return word.to_bytes(self._length, order)[: len(data)]  # type: ignore[arg-type]


class SignalWriter:
    """Reads and writes one mapped signal in payloads of its message, in the map's unit.

    A signal whose range another one tells is read and written in the range that was told last.
    """

    def __init__(self, channel: BusChannel) -> None:
        signal, mapped = channel.signal, channel.mapped
        self.channel, self._field = channel, PayloadField(channel, signal.name)
        self._scale, self._offset = float(signal.scale), float(signal.offset)
        self._range: SignalWriter | None = None
        if channel.range is not None:
            own = replace(channel, signal=channel.range, range=None, integrity=Integrity())
            self._range = SignalWriter(replace(own, mapped=replace(mapped, factor=1.0, offset=0.0)))
        self._stretch = 1.0  # told range per the database's
        self._factor, self._shift = mapped.factor, mapped.offset
        self._is_signed, self._is_float = signal.is_signed, signal.is_float
        self._missing = not_available_raw(channel)
        self._conditions = [
            (PayloadField(channel, multiplexer.name), frozenset(values))
            for multiplexer, values in multiplexing(channel.message, channel.signal)
        ]
        self._low, self._high = raw_limits(channel)

    @property
    def can_be_missing(self) -> bool:
        """Return whether the message can mark the value as not available."""
        return self._missing is not None or self._is_float

    @property
    def step(self) -> float:
        """Return the quantisation step in the map's unit; 0 for a floating-point signal."""
        return 0.0 if self._is_float else abs(self._stretch * self._scale * self._factor)

    def hear(self, data: bytes) -> None:
        """Take the range that a payload may tell; 0 is the database's."""
        if self._range is not None and self._range.is_in(data):
            told = self._range.read(data) / float(self.channel.signal.maximum or 1.0)
            self._stretch = told if told > 0.0 else 1.0

    def is_in(self, data: bytes) -> bool:
        """Return whether a payload carries the signal: long enough, and multiplexed to it."""
        return len(data) > self._field.last_byte and all(
            len(data) > field.last_byte and field.get(data) in values
            for field, values in self._conditions
        )

    def read(self, data: bytes) -> float:
        """Return the value, NaN for not available."""
        raw: float = self._field.get(data)
        if self._is_float:
            bits = self._field.bits
            raw = _FLOATS[bits].unpack(int(raw).to_bytes(bits // 8, "little"))[0]
        elif self._is_signed and raw > self._field.mask >> 1:
            raw -= self._field.mask + 1
        if raw == self._missing:
            return math.nan
        return (raw * self._stretch * self._scale + self._offset) * self._factor + self._shift

    def write(self, data: bytes, value: float) -> bytes:
        """Return the payload with the value, rounded and limited to the signal's raw range.

        value : in the map's unit; NaN, only where ``can_be_missing``, is not available
        """
        return self._field.set(data, self._raw(value))

    def _raw(self, value: float) -> int:
        dbc_value = ((value - self._shift) / self._factor - self._offset) / self._scale
        dbc_value /= self._stretch
        if self._is_float:
            bits = self._field.bits
            try:
                packed = _FLOATS[bits].pack(dbc_value)
            except OverflowError:
                packed = _FLOATS[bits].pack(math.copysign(math.inf, dbc_value))
            return int.from_bytes(packed, "little")
        if math.isnan(value):
            assert self._missing is not None
            return self._missing
        if math.isinf(dbc_value):
            return self._low if dbc_value < 0 else self._high
        return min(max(round(dbc_value), self._low), self._high)


class MessageWriter:
    """Rewrites the frames of one message.

    channels : the message's mapped signals
    """

    def __init__(self, channels: Sequence[BusChannel]) -> None:
        first = channels[0]
        message, integrity = first.message, first.integrity
        self.name, self.frame_id = message.name, message.frame_id
        self.any_source = first.any_source
        self.signals = {each.mapped.name: SignalWriter(each) for each in channels}
        self._lengths = (
            range(1, message.length + 1)
            if message.is_multiplexed()
            else range(message.length, message.length + 1)
        )
        self._counter = PayloadField(first, integrity.counter) if integrity.counter else None
        self._checksum = PayloadField(first, integrity.checksum) if integrity.checksum else None
        self._algorithm = integrity.algorithm

    def is_sound(self, data: bytes) -> bool:
        """Return whether length and checksum are right."""
        if len(data) not in self._lengths:
            return False
        return self._checksum is None or self._checksum.get(data) == self._sum(data)

    def hear(self, data: bytes) -> None:
        """Take the ranges that a sound payload of the ECU tells for the signals behind it."""
        for signal in self.signals.values():
            signal.hear(data)

    def write(self, data: bytes, values: Mapping[str, float], shift: int = 0) -> bytes:
        """Return the payload with new signal values and a repaired checksum.

        values : by mapped name, in the map's unit; signals that the payload lacks are ignored
        shift : added to the alive counter, for frames lost or added before this one
        """
        changed = data
        for name, value in values.items():
            signal = self.signals[name]
            if signal.is_in(data):
                changed = signal.write(changed, value)
        if shift and self._counter is not None:
            changed = self._counter.set(changed, self._counter.get(changed) + shift)
        if changed != data and self._checksum is not None:
            changed = self._checksum.set(changed, self._sum(changed))
        return changed

    def _sum(self, data: bytes) -> int:
        assert self._checksum is not None
        whole = data.ljust(self._lengths[-1], b"\0")
        return payload_checksum(self._algorithm, self.frame_id, whole, self._checksum.last_byte)


def writers(channels: Mapping[str, BusChannel]) -> dict[Key, MessageWriter]:
    """Return a writer for every message of a bus map, by identifier and whether it has 29 bits."""
    groups: dict[Key, list[BusChannel]] = {}
    for channel in channels.values():
        message = channel.message
        groups.setdefault((message.frame_id, message.is_extended_frame), []).append(channel)
    return {key: MessageWriter(group) for key, group in groups.items()}
