"""The plan of a message, made from database and map before its frames come."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from cantools.database.can import Message, Signal
from numpy.typing import NDArray

from monitor.base.errors import SignalMapError
from monitor.base.types import BoolArray, FloatArray
from monitor.decode.bus_map import BusChannel, BusMap
from monitor.decode.checksum import payload_checksums
from monitor.decode.parameter_groups import mask_of
from monitor.decode.payloads import Bytes, Payloads
from monitor.decode.raw_values import bit_position, last_byte, not_available_raw, plausible_range
from monitor.frames.blocks import EXTENDED

Member = tuple[int, BusChannel]  # channel number, channel
Conditions = tuple[tuple[str, tuple[int, ...]], ...]  # multiplexers with the values wanted
_ALL_BITS: Final = 0xFFFFFFFF


def plans_of(bus_map: BusMap, channels: Sequence[str]) -> dict[int, "Plan"]:
    """Return the plans of the messages that carry the channels, by the key of their frames."""
    members: dict[int, list[Member]] = {}
    for index, name in enumerate(channels):
        channel = bus_map.channels[name]
        message = channel.message
        key = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
        members.setdefault(key, []).append((index, channel))
    return {key: Plan(key, each) for key, each in members.items()}


class Plan:
    """Checks and contents of one message.

    key : of its frames
    members : the wanted channels with their numbers
    Raises SignalMapError if the checksum does not fill a byte.
    """

    def __init__(self, key: int, members: Sequence[Member]) -> None:
        channel = members[0][1]
        message, integrity = channel.message, channel.integrity
        self.message, self.name, self.size = message, message.name, int(message.length)
        self.is_optional = all(each.mapped.is_optional for _, each in members)
        self.any_source, self.address = channel.any_source, key & 0xFF
        mask = mask_of(key & ~EXTENDED) | EXTENDED if self.any_source else _ALL_BITS
        self.match = np.uint32(mask), np.uint32(key & mask)  # bits of a key, and their value
        self.is_multiplexed = message.is_multiplexed()
        self.algorithm = integrity.algorithm
        self.checksum = _checksum_byte(channel) if integrity.checksum else -1
        self.counter = message.get_signal_by_name(integrity.counter) if integrity.counter else None
        ranges = {c.range.name: c.range for _, c in members if c.range is not None}
        self.ranges = [(s, _tested(message, multiplexing(message, s))) for s in ranges.values()]
        groups: dict[Conditions, list[Member]] = {}
        for member in members:
            conditions = multiplexing(message, member[1].signal)
            groups.setdefault(conditions, []).append(member)
        self.groups = [
            Group(message, conditions, group)
            for conditions, group in sorted(groups.items(), key=lambda item: len(item[0]))
        ]
        self.is_plain = len(self.groups) == 1 and not self.groups[0].conditions

    def fits(self, length: Bytes) -> BoolArray:
        """Return which frames have a right number of bytes, (n,).

        A multiplexed message may be shorter: OBD responses come with and without padding.
        """
        return np.asarray(
            length <= self.size if self.is_multiplexed else length == self.size, dtype=np.bool_
        )

    def payload(self, data: Bytes) -> Bytes:
        """Return the frames' data, (n, width), as wide as the message."""
        data = data[:, : self.size]
        missing = self.size - data.shape[1]
        return np.pad(data, ((0, 0), (0, missing))) if missing else data

    def holds(self, data: Bytes) -> BoolArray:
        """Return where the checksum holds, (n,); data : (n, size)."""
        if self.checksum < 0:
            return np.ones(len(data), dtype=np.bool_)
        wanted = payload_checksums(self.algorithm, self.message.frame_id, data, self.checksum)
        return np.asarray(wanted == data[:, self.checksum], dtype=np.bool_)

    def count(self, payloads: Payloads) -> NDArray[np.uint64]:
        """Return the alive counter's bits, (n,), which may be a signed signal."""
        assert self.counter is not None
        mask = np.uint64((1 << self.counter.length) - 1)
        return np.asarray(payloads.raw(self.counter).astype(np.uint64) & mask)


class ChannelReader:
    """Reads one channel of a message's payloads in the map's unit."""

    def __init__(self, channel: BusChannel) -> None:
        signal, mapped = channel.signal, channel.mapped
        steps = ((signal.scale, signal.offset), (mapped.factor, mapped.offset))
        self._signal, self._steps = signal, [step for step in steps if step != (1, 0)]
        self._missing = not_available_raw(channel)
        self.range = channel.range
        self._low, self._high = plausible_range(channel)

    def read(
        self, payloads: Payloads, out: FloatArray, most: FloatArray | None = None
    ) -> tuple[int, int]:
        """Fill ``out``, (n,), NaN where not available and inf where out of range.

        most : (n,) highest value in the database's unit, 0 where it is the database's
        Returns how many are not available and how many out of range.
        """
        raw = payloads.raw(self._signal)
        number = raw.astype(np.float64)
        if most is not None:
            number *= np.where(most > 0.0, most / float(self._signal.maximum or 1.0), 1.0)
        for factor, offset in self._steps:
            number = number * float(factor) + float(offset)
        out[:] = number
        good = (self._low <= out) & (out <= self._high) & np.isfinite(out)
        n_missing = 0
        if self._missing is not None:
            missing = np.asarray(raw == self._missing, dtype=np.bool_)
            n_missing = int(np.count_nonzero(missing))
            good &= ~missing
        n_bad = len(out) - int(np.count_nonzero(good))
        if n_bad:
            out[~good] = np.inf
        if n_missing:
            out[missing] = np.nan
        return n_missing, n_bad - n_missing


class Group:
    """Channels of a message that come under the same multiplexer values."""

    def __init__(self, message: Message, conditions: Conditions, members: Sequence[Member]) -> None:
        self.conditions = _tested(message, conditions)
        self.channels = tuple(index for index, _ in members)
        self.readers = [ChannelReader(channel) for _, channel in members]
        self.n_bytes = max(last_byte(message, channel.signal) for _, channel in members) + 1


def _tested(message: Message, conditions: Conditions) -> list[tuple[Signal, tuple[int, ...]]]:
    return [(message.get_signal_by_name(name), ids) for name, ids in conditions]


def multiplexing(message: Message, signal: Signal) -> Conditions:
    """Return the multiplexer values under which the frame carries the signal, outermost first."""
    found: list[tuple[str, tuple[int, ...]]] = []
    while signal.multiplexer_signal is not None:
        found.append((signal.multiplexer_signal, tuple(signal.multiplexer_ids or ())))
        signal = message.get_signal_by_name(signal.multiplexer_signal)
    return tuple(reversed(found))


def _checksum_byte(channel: BusChannel) -> int:
    """Return the number of the byte that holds the message's checksum."""
    message = channel.message
    signal: Signal = message.get_signal_by_name(channel.integrity.checksum)
    if signal.length != 8 or bit_position(message, signal) % 8 or signal.is_signed:
        raise SignalMapError(
            f"{channel.map_path}: checksum {message.name}.{signal.name} of {channel.dbc} "
            "must be an unsigned byte of its own"
        )
    return int(signal.start // 8)
