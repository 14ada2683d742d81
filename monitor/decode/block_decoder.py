"""Blocks of frames to values.

Checks, in this order: length, checksum, counter, multiplexer, not available, plausible range. A
frame that fails one of the first three is counted and dropped; a value that fails one of the last
two is counted and marked. Nothing here is ever fatal, and no result depends on where blocks begin.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from cantools.database.can import Signal
from numpy.typing import NDArray

from monitor.base.types import BoolArray, FloatArray, FrameBlock, IntArray
from monitor.decode.bus_map import BusMap
from monitor.decode.parameter_groups import Sender, group_of, mask_of
from monitor.decode.payloads import Bytes, Payloads
from monitor.decode.plan import Group, Plan, plans_of
from monitor.frames.blocks import EXTENDED

_STANDARD = 1 << 11  # identifiers of 11 bits


@dataclass(frozen=True, slots=True)
class MessageCounters:
    """Counts of the frames of one message."""

    received: int = 0
    length: int = 0  # dropped: wrong number of bytes
    checksum: int = 0  # dropped: checksum does not hold
    stuck: int = 0  # dropped: counter did not advance
    other: int = 0  # not used: multiplexed to signals nobody asked for
    lost: int = 0  # frames that the counter says are missing
    not_available: int = 0  # values that the sender marks as not available
    out_of_range: int = 0  # values outside the plausible range


class Decoded(NamedTuple):
    """Values of the frames of one message: row i of ``values`` belongs to channel i."""

    rows: IntArray  # (m,) numbers of the frames within their block, ascending
    channels: tuple[int, ...]  # channel numbers
    values: FloatArray  # (n_channels, m) canonical units; NaN not available, inf out of range


class BlockDecoder:
    """Decodes the frames that carry ``names``; everything else is skipped and counted.

    bus_map : what the bus provides
    names : canonical signals wanted, any of ``bus_map.names`` and ``bus_map.optional``
    Raises SignalMapError if a name is not provided or a protected signal does not fit.
    """

    def __init__(self, bus_map: BusMap, names: Sequence[str]) -> None:
        self.names, self.channels = tuple(names), bus_map.sources(names)
        self.derived = tuple(bus_map.derived[name] for name in names if name in bus_map.derived)
        timeouts_s = (bus_map.channels[name].mapped.timeout_s for name in self.channels)
        self.timeouts_ns = tuple(round(1e9 * s) for s in timeouts_s)
        self.plans = plans_of(bus_map, self.channels)  # by the key of their frames
        self._is_needed = np.zeros(_STANDARD + 1, dtype=np.bool_)  # the last: any longer one
        self._is_needed[[key for key in self.plans if key < _STANDARD]] = True
        self._beyond = [plan.match for key, plan in self.plans.items() if key >= _STANDARD]
        self.restart()

    def restart(self) -> None:
        """Forget everything, as if made anew for another recording."""
        self.unmapped = 0  # frames under identifiers nobody asked for
        self._messages = [_MessageDecoder(plan) for plan in self.plans.values()]

    def push(self, block: FrameBlock) -> list[Decoded]:
        """Return the frames' values, message by message; rows may repeat between messages' parts.

        A frame whose multiplexers carry several groups of channels stands in one part for each.
        """
        found: list[Decoded] = []
        self.unmapped += len(block.key)
        for message in self._messages:
            rows = message.rows_of(block.key)
            self.unmapped -= len(rows)
            if len(rows):
                found += message.push(rows, block.length[rows], block.data[rows])
        return found

    @property
    def identifiers(self) -> tuple[tuple[int, bool], ...]:
        """Return (identifier, is_extended) of every needed message, for filters on the bus."""
        plans = self.plans.items()
        return tuple((k & (EXTENDED - 1), k >= EXTENDED) for k, p in plans if not p.any_source)

    @property
    def groups(self) -> tuple[tuple[int, int], ...]:
        """Return (parameter group, its mask) of every needed message that anyone may send."""
        found = [k & (EXTENDED - 1) for k, plan in self.plans.items() if plan.any_source]
        return tuple((group_of(can_id), mask_of(can_id)) for can_id in found)

    def needed(self, block: FrameBlock) -> IntArray:
        """Return which frames of a block are looked at, (m,) ascending."""
        is_needed = self._is_needed.take(block.key, mode="clip")
        for mask, wanted in self._beyond:
            is_needed |= (block.key & mask) == wanted
        return np.flatnonzero(is_needed)

    @property
    def counters(self) -> dict[str, MessageCounters]:
        """Return the counters by message name, of optional messages only if they came."""
        counters = {each.plan: MessageCounters(**each.counts) for each in self._messages}
        return {plan.name: c for plan, c in counters.items() if c.received or not plan.is_optional}


class _MessageDecoder:
    """Decodes the frames of one message; remembers its counts and its last counter."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.counts: Counter[str] = Counter()  # by the names of ``MessageCounters``
        self._sender = Sender(plan.address) if plan.any_source else None
        self._last: NDArray[np.uint64] | None = None  # (1,) of the last frame that was sound
        self._ranges: dict[str, float] = {}  # range signal → what it told last

    def rows_of(self, key: NDArray[np.uint32]) -> IntArray:
        """Return which frames are of this message, (m,) ascending; their keys are (n,)."""
        mask, wanted = self.plan.match
        if self._sender is None:
            return np.flatnonzero(key == wanted)
        rows = np.flatnonzero((key & mask) == wanted)
        return rows[self._sender.takes((key[rows] & 0xFF).astype(np.int64))]

    def push(self, rows: IntArray, length: Bytes, data: Bytes) -> list[Decoded]:
        """Return the parts that frames say: ``rows`` in their block, (m,), data (m, width)."""
        plan = self.plan
        self.counts["received"] += len(rows)
        data = plan.payload(data)
        rows, length, data = self._keep(plan.fits(length), "length", rows, length, data)
        if plan.checksum >= 0:
            rows, length, data = self._keep(plan.holds(data), "checksum", rows, length, data)
        payloads = Payloads(plan.message, data)
        if plan.counter is not None and len(rows):
            advances = self._count(plan.count(payloads), plan.counter)
            if not advances.all():
                rows, length, data = self._keep(advances, "stuck", rows, length, data)
                payloads = Payloads(plan.message, data)
        if plan.is_plain:
            (group,) = plan.groups
            return [Decoded(rows, group.channels, self._values(group, payloads, {}))]
        return self._multiplexed(rows, length, payloads)

    def _keep(
        self, sound: BoolArray, reason: str, rows: IntArray, length: Bytes, data: Bytes
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
        self.counts["lost"] += sum(gap[known & ~stuck & (gap > 0)].tolist())
        return np.asarray(~stuck)

    def _multiplexed(self, rows: IntArray, length: Bytes, payloads: Payloads) -> list[Decoded]:
        """Return a part for each group of channels; a frame too short for one is not used."""
        alive, used = np.ones(len(rows), dtype=np.bool_), np.zeros(len(rows), dtype=np.bool_)
        tested = [g.conditions for g in self.plan.groups] + [c for _, c in self.plan.ranges]
        signals = {s.name: s for conditions in tested for s, _ in conditions}
        raw = {name: payloads.raw(signal) for name, signal in signals.items()}

        def carrying(conditions: Sequence[tuple[Signal, tuple[int, ...]]]) -> BoolArray:
            each = [np.logical_or.reduce([raw[s.name] == i for i in ids]) for s, ids in conditions]
            return np.asarray(np.logical_and.reduce([alive, *each]))

        most = {}
        for signal, conditions in self.plan.ranges:
            tells = carrying(conditions)
            used |= tells
            most[signal.name] = self._held(signal, tells, payloads)
        found: list[tuple[Group, BoolArray]] = []
        for group in self.plan.groups:
            carries = carrying(group.conditions)
            if carries.any():
                short = carries & (length < group.n_bytes)
                self.counts["length"] += int(np.count_nonzero(short))
                alive = alive & ~short
                used |= carries
                found.append((group, carries))
        self.counts["other"] += int(np.count_nonzero(alive & ~used))
        places = [(group, np.flatnonzero(carries & alive)) for group, carries in found]
        return [
            Decoded(
                rows[i],
                g.channels,
                self._values(g, payloads.at(i), {name: m[i] for name, m in most.items()}),
            )
            for g, i in places
        ]

    def _held(self, signal: Signal, tells: BoolArray, payloads: Payloads) -> FloatArray:
        """Return what a range signal told last at each frame, (n,), 0 before it told anything."""
        told = payloads.raw(signal) * float(signal.scale) + float(signal.offset)
        last = np.maximum.accumulate(np.where(tells, np.arange(1, len(tells) + 1), 0))
        held = np.concatenate([[self._ranges.get(signal.name, 0.0)], told])[last]
        self._ranges[signal.name] = float(held[-1]) if len(held) else 0.0
        return np.asarray(held)

    def _values(
        self, group: Group, payloads: Payloads, most: Mapping[str, FloatArray]
    ) -> FloatArray:
        values = np.empty((len(group.readers), len(payloads)))
        with np.errstate(all="ignore"):
            for reader, row in zip(group.readers, values, strict=True):
                range_of = reader.range
                missing, outside = reader.read(
                    payloads, row, most.get(range_of.name) if range_of else None
                )
                self.counts["not_available"] += missing
                self.counts["out_of_range"] += outside
        return values
