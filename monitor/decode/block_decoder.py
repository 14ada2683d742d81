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

from monitor.base.runs import alike
from monitor.base.types import BoolArray, FloatArray, FrameBlock, IntArray
from monitor.decode.bus_map import BusMap
from monitor.decode.parameter_groups import Sender, group_of, mask_of
from monitor.decode.payloads import Bytes, Numbers, Raw
from monitor.decode.plan import Checks, Conditions, Group, Plan, plans_of
from monitor.frames.blocks import EXTENDED

_STANDARD = 1 << 11  # identifiers of 11 bits
# message by message, each (n,): rows in the block, numbers of the plans, length, and data
_Frames = tuple[IntArray, Numbers, Bytes, Bytes]


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
        self.checks = Checks(tuple(self.plans.values()))
        self._number = np.full(_STANDARD + 1, len(self.plans), dtype=np.int16)  # of plans, by key
        self._beyond = []  # number, and bits of a key with their value
        for i, (key, plan) in enumerate(self.plans.items()):
            if key < _STANDARD:
                self._number[key] = i
            else:
                self._beyond.append((i, plan.match))
        self.restart()

    def restart(self) -> None:
        """Forget everything, as if made anew for another recording."""
        self.unmapped = 0  # frames under identifiers nobody asked for
        self._messages = [_Message(plan) for plan in self.plans.values()]

    def push(self, block: FrameBlock) -> list[Decoded]:
        """Return the frames' values, message by message; rows may repeat between messages' parts.

        A frame whose multiplexers carry several groups of channels stands in one part for each.
        """
        which = self._which(block.key)
        for i, message in enumerate(self._messages):
            if message.sender is not None:
                own = np.flatnonzero(which == i)
                taken = message.sender.takes((block.key[own] & 0xFF).astype(np.int64))
                which[own[~taken]] = len(self.plans)
        *received, unmapped = np.bincount(which, minlength=len(self.plans) + 1).tolist()
        self.unmapped += unmapped
        for message, n in zip(self._messages, received, strict=True):
            message.counts["received"] += n
        rows = which.argsort(kind="stable")[: sum(received)]
        frames = rows, which[rows], block.length[rows], block.data[rows]
        frames = self._kept("length", self.checks.fits(frames[2], frames[1]), frames)
        frames = self._kept("checksum", self.checks.holds(frames[3], frames[1]), frames)
        frames = self._kept("stuck", self._advances(frames[1], frames[3]), frames)
        rows, which, length, data = frames
        found: list[Decoded] = []
        with np.errstate(all="ignore"):
            for a, b, i in alike(which):
                found += self._messages[i].push(rows[a:b], length[a:b], data[a:b])
        return found

    def _which(self, key: NDArray[np.uint32]) -> Numbers:
        """Return the number of each frame's plan, (n,), or how many plans there are."""
        which = self._number.take(key, mode="clip")
        for i, (mask, wanted) in self._beyond:
            which[(key & mask) == wanted] = i
        return which

    def _kept(self, reason: str, sound: BoolArray, frames: _Frames) -> _Frames:
        """Drop and count the frames that are not sound."""
        if np.count_nonzero(sound) == len(sound):
            return frames
        rows, which, length, data = frames
        for i, n in Counter(which[~sound].tolist()).items():
            self._messages[i].counts[reason] += n
        return rows[sound], which[sound], length[sound], data[sound]

    def _advances(self, which: Numbers, data: Bytes) -> BoolArray:
        """Return where the counter advanced, (n,); count the frames that it says are missing.

        A frame that is rejected has the counter of the last sound one, so each is compared with
        the frame just before it.
        """
        count, mask = self.checks.counters.bits(data, which), self.checks.counted.take(which)
        before = count - np.uint64(1)
        for begin, end, i in alike(which):
            last, self._messages[i].last = self._messages[i].last, count[end - 1]
            before[begin] = before[begin] if last is None else last
            before[begin + 1 : end] = count[begin : end - 1]
        step = (count - before) & mask
        for i, n in zip(which[step > 1].tolist(), step[step > 1].tolist(), strict=True):
            self._messages[i].counts["lost"] += n - 1
        return np.asarray((step > 0) | (mask == 0))

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
        return np.flatnonzero(self._which(block.key) < len(self.plans))

    @property
    def counters(self) -> dict[str, MessageCounters]:
        """Return the counters by message name, of optional messages only if they came."""
        counters = {each.plan: MessageCounters(**each.counts) for each in self._messages}
        return {plan.name: c for plan, c in counters.items() if c.received or not plan.is_optional}


class _Message:
    """One message; remembers its counts, its last counter and what its range signals told."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.counts: Counter[str] = Counter()  # by the names of ``MessageCounters``
        self.sender = Sender(plan.address) if plan.any_source else None
        self.last: np.uint64 | None = None  # counter of the last frame that was sound
        self._ranges: dict[str, float] = {}  # range signal → what it told last

    def push(self, rows: IntArray, length: Bytes, data: Bytes) -> list[Decoded]:
        """Return the parts that sound frames say: ``rows`` in their block, (m,)."""
        if not self.plan.is_plain:
            return self._multiplexed(rows, length, data)
        (group,) = self.plan.groups
        return [self._part(group, rows, data, {})]

    def _multiplexed(self, rows: IntArray, length: Bytes, data: Bytes) -> list[Decoded]:
        """Return a part for each group of channels; a frame too short for one is not used."""
        alive, used = np.ones(len(rows), dtype=np.bool_), np.zeros(len(rows), dtype=np.bool_)
        read, odd = self.plan.tests.read(data)
        raw = {s.name: odd.get(i, read[i]) for i, s in enumerate(self.plan.tested)}

        def carrying(conditions: Conditions) -> BoolArray:
            each = [np.logical_or.reduce([raw[s.name] == i for i in ids]) for s, ids in conditions]
            return np.asarray(np.logical_and.reduce([alive, *each]))

        most = {}
        for signal, conditions in self.plan.ranges:
            tells = carrying(conditions)
            used |= tells
            most[signal.name] = self._held(signal, tells, raw[signal.name])
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
            self._part(group, rows[i], data[i], {name: m[i] for name, m in most.items()})
            for group, i in places
        ]

    def _held(self, signal: Signal, tells: BoolArray, raw: Raw) -> FloatArray:
        """Return what a range signal told last at each frame, (n,), 0 before it told anything."""
        told = raw * float(signal.scale) + float(signal.offset)
        last = np.maximum.accumulate(np.where(tells, np.arange(1, len(tells) + 1), 0))
        held = np.concatenate([[self._ranges.get(signal.name, 0.0)], told])[last]
        self._ranges[signal.name] = float(held[-1]) if len(held) else 0.0
        return np.asarray(held)

    def _part(
        self, group: Group, rows: IntArray, data: Bytes, most: Mapping[str, FloatArray]
    ) -> Decoded:
        values, missing, outside = group.read(data, most)
        self.counts["not_available"] += missing
        self.counts["out_of_range"] += outside
        return Decoded(rows, group.channels, values)
