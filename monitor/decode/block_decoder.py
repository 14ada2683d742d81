"""The decoder for blocks of frames, equal to ``decode.Decoder`` bit for bit.

The checks and their order are those of ``decoder_source``, over all frames of a message at once; a
property test holds the two together.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from cantools.database.can import Message, Signal
from numpy.typing import NDArray

from monitor.base.types import BoolArray, FloatArray, FrameBlock, IntArray
from monitor.decode.bus_map import BusMap, Channel
from monitor.decode.checksum import payload_checksums
from monitor.decode.decoder import EXTENDED, MessageCounters, by_message, counters_of, is_optional
from monitor.decode.decoder_source import (
    Conditions,
    Member,
    Reason,
    branches,
    checksum_byte,
    last_byte,
)
from monitor.decode.parameter_groups import Sender, mask_of
from monitor.decode.payloads import Bytes, Payloads
from monitor.decode.raw_values import (
    not_available_raw,
    plausible_range,
    plausible_raw,
    scaling,
)

_STANDARD = 1 << 11  # identifiers of 11 bits


class Decoded(NamedTuple):
    """Values of the frames of one message: row i of ``values`` belongs to channel i."""

    rows: IntArray  # (m,) numbers of the frames within their block, ascending
    channels: tuple[int, ...]  # channel numbers
    values: FloatArray  # (n_channels, m) canonical units; NaN not available, inf out of range


class BlockDecoder:
    """Decodes the frames that carry ``names``; everything else is skipped and counted.

    Attributes, counters and errors are those of ``Decoder``; the memory of counters goes from
    block to block.
    """

    def __init__(self, bus_map: BusMap, names: Sequence[str]) -> None:
        self.names, self.channels, self.derived, self.timeouts_ns = bus_map.wanted(names)
        self._plans = {
            key: Plan(key, members) for key, members in by_message(bus_map, self.channels).items()
        }
        self._is_needed = np.zeros(_STANDARD + 1, dtype=np.bool_)  # the last: any longer one
        self._is_needed[[key for key in self._plans if key < _STANDARD]] = True
        self._beyond = [plan.match for key, plan in self._plans.items() if key >= _STANDARD]
        self.restart()

    def restart(self) -> None:
        """Forget everything, as if made anew for another recording."""
        self.unmapped = 0  # frames under identifiers nobody asked for
        self._messages = {key: _MessageDecoder(plan) for key, plan in self._plans.items()}

    def push(self, block: FrameBlock) -> list[Decoded]:
        """Return the frames' values, message by message; rows may repeat between messages' parts.

        A frame whose multiplexers carry several groups of channels stands in one part for each.
        """
        found: list[Decoded] = []
        self.unmapped += len(block.key)
        for message in self._messages.values():
            rows = message.rows_of(block.key)
            self.unmapped -= len(rows)
            if len(rows):
                found += message.push(rows, block.length[rows], block.data[rows])
        return found

    @property
    def plans(self) -> Mapping[int, "Plan"]:
        """Return the plan of each needed message, by the key of its frames."""
        return self._plans

    def needed(self, block: FrameBlock) -> IntArray:
        """Return which frames of a block are looked at, (m,) ascending."""
        is_needed = self._is_needed.take(block.key, mode="clip")
        for mask, wanted in self._beyond:
            is_needed |= (block.key & mask) == wanted
        return np.flatnonzero(is_needed)

    @property
    def counters(self) -> dict[str, MessageCounters]:
        """Return the counters by message name, of optional messages only if they came."""
        counters = {each.plan: counters_of(each.counts) for each in self._messages.values()}
        return {plan.name: c for plan, c in counters.items() if c.received or not plan.is_optional}


class Plan:
    """The plan of a message, made before its frames come."""

    def __init__(self, key: int, members: Sequence[Member]) -> None:
        channel = members[0][1]
        self.is_optional = is_optional(members)
        self.any_source, self.address = channel.any_source, key & 0xFF
        mask = mask_of(key & ~EXTENDED) | EXTENDED if self.any_source else 0xFFFFFFFF
        self.match = np.uint32(mask), np.uint32(key & mask)  # bits of a key, and their value
        message, integrity = channel.message, channel.integrity
        self.message, self.name, self.size = message, message.name, int(message.length)
        self.is_multiplexed = message.is_multiplexed()
        self.algorithm = integrity.algorithm
        self.checksum = checksum_byte(channel) if integrity.checksum else -1
        self.counter = message.get_signal_by_name(integrity.counter) if integrity.counter else None
        self.groups = [
            _Group(message, conditions, group) for conditions, group in branches(members).items()
        ]
        self.is_plain = len(self.groups) == 1 and not self.groups[0].conditions

    def fits(self, length: Bytes) -> BoolArray:
        """Return which frames have a right number of bytes, (n,)."""
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

    def count(self, payloads: "Payloads") -> NDArray[np.uint64]:
        """Return the alive counter's bits, (n,), which may be a signed signal."""
        assert self.counter is not None
        mask = np.uint64((1 << self.counter.length) - 1)
        return np.asarray(payloads.raw(self.counter).astype(np.uint64) & mask)


class _Group:
    """Channels of a message that come under the same multiplexer values."""

    def __init__(self, message: Message, conditions: Conditions, members: Sequence[Member]) -> None:
        self.conditions = [(message.get_signal_by_name(name), ids) for name, ids in conditions]
        self.channels = tuple(index for index, _ in members)
        self.readers = [_ChannelReader(channel) for _, channel in members]
        self.n_bytes = max(last_byte(message, channel.signal) for _, channel in members) + 1


class _MessageDecoder:
    """Decodes the frames of one message; remembers its counts and its last counter."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.counts = [0] * len(Reason)
        self._sender = Sender(plan.address) if plan.any_source else None
        self._last: NDArray[np.uint64] | None = None  # (1,) of the last frame that was sound

    def rows_of(self, key: NDArray[np.uint32]) -> IntArray:
        """Return which frames are of this message, (m,) ascending; their keys are (n,)."""
        mask, wanted = self.plan.match
        if self._sender is None:
            return np.flatnonzero(key == wanted)
        rows = np.flatnonzero((key & mask) == wanted)
        return rows[self._sender.takes_of((key[rows] & 0xFF).astype(np.int64))]

    def push(self, rows: IntArray, length: Bytes, data: Bytes) -> list[Decoded]:
        """Return the parts that frames say: ``rows`` in their block, (m,), data (m, width)."""
        plan, counts = self.plan, self.counts
        counts[Reason.RECEIVED] += len(rows)
        data = plan.payload(data)
        rows, length, data = self._keep(plan.fits(length), Reason.LENGTH, rows, length, data)
        if plan.checksum >= 0:
            rows, length, data = self._keep(plan.holds(data), Reason.CHECKSUM, rows, length, data)
        payloads = Payloads(plan.message, data)
        if plan.counter is not None and len(rows):
            advances = self._count(plan.count(payloads), plan.counter)
            if not advances.all():
                rows, length, data = self._keep(advances, Reason.STUCK, rows, length, data)
                payloads = Payloads(plan.message, data)
        if plan.is_plain:
            (group,) = plan.groups
            return [Decoded(rows, group.channels, self._values(group, payloads))]
        return self._multiplexed(rows, length, payloads)

    def _keep(
        self, sound: BoolArray, reason: Reason, rows: IntArray, length: Bytes, data: Bytes
    ) -> tuple[IntArray, Bytes, Bytes]:
        """Drop and count the frames that are not sound."""
        n_kept = int(np.count_nonzero(sound))
        if n_kept == len(rows):
            return rows, length, data
        self.counts[reason] += len(rows) - n_kept
        return rows[sound], length[sound], data[sound]

    def _count(self, count: NDArray[np.uint64], signal: Signal) -> BoolArray:
        """Return whether the counter advanced, (n,); count the frames that it says are missing.

        A frame that is rejected has the counter of the last sound one, so each is compared with
        the frame just before it.
        """
        mask = np.uint64((1 << signal.length) - 1)
        known = np.ones(len(count), dtype=np.bool_)
        known[0] = self._last is not None
        before = np.concatenate([count[:1] if self._last is None else self._last, count[:-1]])
        self._last = count[-1:].copy()
        stuck = known & (count == before)
        gap = (count - before - np.uint64(1)) & mask
        self.counts[Reason.LOST] += sum(gap[known & ~stuck & (gap > 0)].tolist())
        return np.asarray(~stuck)

    def _multiplexed(self, rows: IntArray, length: Bytes, payloads: "Payloads") -> list[Decoded]:
        counts = self.counts
        alive, used = np.ones(len(rows), dtype=np.bool_), np.zeros(len(rows), dtype=np.bool_)
        found: list[tuple[_Group, BoolArray]] = []
        for group in self.plan.groups:
            carries = alive.copy()
            for signal, ids in group.conditions:
                carries &= np.isin(payloads.raw(signal), ids)
            short = carries & (length < group.n_bytes)
            counts[Reason.LENGTH] += int(np.count_nonzero(short))
            alive &= ~short
            used |= carries
            found.append((group, carries))
        counts[Reason.OTHER] += int(np.count_nonzero(alive & ~used))
        parts = []
        for group, carries in found:  # of a frame that is too short for one group nothing is said
            places = np.flatnonzero(carries & alive)
            values = self._values(group, payloads.at(places))
            parts.append(Decoded(rows[places], group.channels, values))
        return parts

    def _values(self, group: _Group, payloads: "Payloads") -> FloatArray:
        values = np.empty((len(group.readers), len(payloads)))
        for reader, row in zip(group.readers, values, strict=True):
            missing, outside = reader.read(payloads, row)
            self.counts[Reason.NOT_AVAILABLE] += missing
            self.counts[Reason.OUT_OF_RANGE] += outside
        return values


class _ChannelReader:
    """Raw values of one channel to values in the map's unit."""

    def __init__(self, channel: Channel) -> None:
        expression = scaling(channel)
        self._signal = channel.signal
        self._scaled: Callable[[Any], Any] = eval(f"lambda raw: {expression}")
        self._missing = not_available_raw(channel)
        if channel.signal.is_float:
            self._low, self._high = plausible_range(channel)
        else:
            self._bottom, self._top = plausible_raw(channel, expression)

    def read(self, payloads: "Payloads", out: FloatArray) -> tuple[int, int]:
        """Fill ``out``, (n,); return how many are not available and how many out of range."""
        raw = payloads.raw(self._signal)
        if self._signal.is_float:
            with np.errstate(all="ignore"):
                out[:] = self._scaled(raw)
            good = np.isfinite(out) & (self._low <= out) & (out <= self._high)
            missing = np.zeros(len(out), dtype=np.bool_)
        else:
            out[:] = self._scaled(raw if raw.dtype == object else raw.astype(np.float64))
            good = np.asarray((raw >= self._bottom) & (raw <= self._top), dtype=np.bool_)
            if good.all():
                return 0, 0
            missing = ~good & np.asarray(raw == self._missing, dtype=np.bool_)
        out[~good] = np.inf
        out[missing] = np.nan
        n_missing = int(np.count_nonzero(missing))
        return n_missing, int(np.count_nonzero(~good)) - n_missing
