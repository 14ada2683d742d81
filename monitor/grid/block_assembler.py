"""Values to samples: everything that arrives, brought onto one fixed grid.

Tick k stands at t0 + k * period in integer nanoseconds, t0 being the time of the first frame.
Sample k >= 1 holds for each signal the mean of the good values received in (t_(k-1), t_k], the
first frames' own time included in sample 1; averaging keeps fast signals from folding back. If
only bad values came, the sample says so; if none came, the last tick's value is held until it is
older than the signal's timeout, then it is stale. Sample k leaves when the first frame after t_k
arrives; any frame moves time, whether its signals are wanted or not. Behind a pause of the whole
log of which nothing is known the grid begins anew, and a signal is stale only after its timeout.

Frames come in blocks, in the order of the log; state goes from block to block. Their times are
looked at in a few passes: where they rise, every frame is in time; where some do not, those older
than the open tick are found by the newest time before each.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from monitor.base.errors import SignalMapError
from monitor.base.types import FloatArray, IntArray, Quality, QualityArray, SampleBlock
from monitor.decode.block_decoder import BlockDecoder, Decoded
from monitor.decode.signal_map import Derived
from monitor.frames.blocks import LATEST_S
from monitor.grid.derived import Output

Series = tuple[IntArray, FloatArray]  # times and values of one channel, both (n,)
MAX_JUMP_NS: Final = 60_000_000_000  # a longer pause is a break in the recording, not a gap
LATEST_NS: Final = int(LATEST_S * 1e9)
MAX_LATE: Final = 100  # so many late frames in a row mean that the clock went backwards
_NONE = np.empty(0, dtype=np.int64)
_STALE, _OFF_BUS, _GAP = int(Quality.STALE), int(Quality.OFF_BUS), int(Quality.GAP)


@dataclass(slots=True)
class AssemblerCounters:
    """Counts of the frames by the fate of their times."""

    late: int = 0  # dropped: older than the open tick, or a time that no clock shows
    discontinuities: int = 0  # times the grid was anchored anew


class BlockAssembler:
    """Collects the values of frames into samples.

    channels : names of what the frames carry, in the order of their numbers
    names : what a sample holds, each a channel or a derived signal
    period_ns : grid period, above 0 and at most MAX_JUMP_NS
    timeouts_ns : how long the value of each channel may be held
    """

    def __init__(
        self,
        channels: Sequence[str],
        names: Sequence[str],
        period_ns: int,
        timeouts_ns: Sequence[int],
        derived: Sequence[Derived] = (),
    ) -> None:
        check_grid(period_ns)
        if len(timeouts_ns) != len(channels):
            raise SignalMapError(f"{len(channels)} channels have {len(timeouts_ns)} timeouts")
        self.counters = AssemblerCounters()
        self.is_off_bus = False  # the monitor itself hears nothing, from the last frame pushed on
        self.is_live = False  # the loop's own frames came: the recording was made live
        self.period_ns = period_ns
        self._timeouts_ns = np.array(timeouts_ns, dtype=np.int64)
        self._output = Output(channels, names, derived)
        self._n_names = len(names)
        self._received_ns = np.zeros(len(channels), dtype=np.int64)  # each channel's last value
        self._n = 0  # samples that are complete
        self._grid: _Grid | None = None
        self._newest_ns = 0  # time on the grid
        self._late_in_a_row = 0

    @classmethod
    def of(cls, decoder: BlockDecoder, period_ns: int) -> "BlockAssembler":
        """Return an assembler for the values of ``decoder``."""
        return cls(decoder.channels, decoder.names, period_ns, decoder.timeouts_ns, decoder.derived)

    @property
    def open_ns(self) -> tuple[int, int]:
        """Return the first and the last time of the open tick, 1 and 0 before the first frame."""
        if self._grid is None:
            return 1, 0
        tick = self._grid.open_tick(self._newest_ns)
        begin_ns = self._grid.anchor_ns + tick * self.period_ns
        return begin_ns + (tick > 0), begin_ns + self.period_ns

    def push(
        self, t_ns: IntArray, decoded: Iterable[Decoded] = (), gaps: Sequence[int] = ()
    ) -> SampleBlock:
        """Take the times of a block's frames, (n,), wanted or not, and their values.

        gaps : places of ``log_gap`` frames, at which the grid begins anew
        Returns the samples that are complete before the last frame.
        """
        parts, found = list(decoded), []
        begun = set(gaps)
        for begin, end in pairwise(sorted({0, *begun, len(t_ns)})):
            if begin in begun:
                found += self.begin(int(t_ns[begin]))
            found += self._push(t_ns, parts, begin, end)
        return joined(found, self._n_names)

    def _push(
        self, t_ns: IntArray, parts: Sequence[Decoded], begin: int, end: int
    ) -> list[SampleBlock]:
        """Take the frames from begin to end."""
        found = []
        while begin < end:
            grid = self._grid or self._anchor(int(t_ns[begin]))
            stop, late, is_jump = self._until_break(grid, t_ns[begin:end])
            for part in parts:
                inside = slice(*part.rows.searchsorted((begin, begin + stop)).tolist())
                rows, values = part.rows[inside], part.values[:, inside]
                if late.size:
                    kept = ~np.isin(rows, late + begin)
                    rows, values = rows[kept], values[:, kept]
                grid.keep(part.channels, t_ns[rows], values)
            begin += stop
            if begin < end:
                found += self._break(grid, int(t_ns[begin]), is_jump=is_jump)
            else:
                found.append(self._close(grid, grid.open_tick(self._newest_ns)))
        return found

    def begin(
        self, t_ns: int, quality: Quality = Quality.GAP, *, is_jump: bool = False
    ) -> list[SampleBlock]:
        """Begin anew at ``t_ns``, behind a pause of which nothing is known.

        quality : of what is not received behind it, for as long as its timeout
        is_jump : the open tick is complete
        """
        if self._grid is None:
            self._anchor(t_ns)
            return []
        return self._break(self._grid, t_ns, is_jump=is_jump, quality=int(quality))

    def _until_break(self, grid: "_Grid", t_ns: IntArray) -> tuple[int, IntArray, bool]:
        """Return how many frames come before a break, which of them are late, and if it is a jump.

        Moves the newest time, counts what is late; t_ns : (n,) at least one
        """
        own_ns = t_ns[1:] - t_ns[:-1]
        first_ns = int(t_ns[0]) - self._newest_ns
        least_ns, most_ns = int(own_ns.min(initial=0)), int(own_ns.max(initial=0))
        if min(first_ns, least_ns) >= 0 and max(first_ns, most_ns) <= MAX_JUMP_NS:
            self._newest_ns, self._late_in_a_row = int(t_ns[-1]), 0
            return len(t_ns), _NONE, False
        newest_ns = np.maximum.accumulate(np.concatenate([[self._newest_ns], t_ns]))
        before_ns = newest_ns[:-1]
        older = np.flatnonzero(t_ns < before_ns)
        late = older[t_ns[older] < grid.first_ns(before_ns[older])]
        ahead_ns = t_ns - before_ns  # 64 bits are too few from one end of time to the other
        is_far = (ahead_ns > MAX_JUMP_NS) | (ahead_ns < 0)
        jumps = np.flatnonzero((t_ns > before_ns) & is_far)
        # those late before the block's begin count in the row, too
        places = np.concatenate([np.arange(-self._late_in_a_row, 0), late])
        hundredth = places[MAX_LATE - 1 :][
            places[MAX_LATE - 1 :] - places[: -MAX_LATE + 1] == MAX_LATE - 1
        ]
        ends = [int(found[0]) for found in (jumps, hundredth) if found.size]
        stop = min(ends, default=len(t_ns))
        is_jump = bool(jumps.size) and int(jumps[0]) == stop
        late, places = late[late < stop], places[places < stop]
        self.counters.late += len(late) + (stop < len(t_ns) and not is_jump)
        in_a_row = places - np.arange(len(places)) == stop - len(places)
        self._late_in_a_row = int(np.count_nonzero(in_a_row))
        self._newest_ns = int(newest_ns[stop])
        return stop, late, is_jump

    def _anchor(self, t_ns: int, quality: int = _STALE) -> "_Grid":
        self._grid = _Grid(t_ns, self.period_ns, len(self._timeouts_ns), quality)
        self._newest_ns, self._late_in_a_row = t_ns, 0
        return self._grid

    def _break(
        self, grid: "_Grid", t_ns: int, *, is_jump: bool, quality: int = _STALE
    ) -> list[SampleBlock]:
        """Anchor the grid anew; return the samples up to the one that marks the break."""
        rest = self._close(grid, grid.open_tick(self._newest_ns) + is_jump)
        grid.note_times(self._received_ns)
        self.counters.discontinuities += 1
        self._anchor(t_ns, quality)
        qualities = np.full((1, self._n_names), quality, dtype=np.uint8)
        mark = np.array([t_ns], dtype=np.int64), np.full(qualities.shape, np.nan), qualities
        return [rest, self._numbered(*mark)]

    def _close(self, grid: "_Grid", until: int) -> SampleBlock:
        """Return the samples of the ticks before ``until`` that are still open."""
        values, quality = grid.close(
            until, self._received_ns, self._timeouts_ns, off_bus=self.is_off_bus
        )
        ticks = np.arange(until - len(values) + 1, until + 1, dtype=np.int64)
        t_ns = grid.anchor_ns + ticks * self.period_ns
        return self._numbered(t_ns, *self._output.of(values, quality))

    def _numbered(self, t_ns: IntArray, values: FloatArray, quality: QualityArray) -> SampleBlock:
        index = np.arange(self._n + 1, self._n + 1 + len(t_ns), dtype=np.int64)
        self._n += len(t_ns)
        return SampleBlock(index, t_ns, values, quality)


class _Grid:
    """The grid between two breaks, and the values of its open ticks.

    quality : of what has not been received since the anchor, for as long as its timeout
    """

    def __init__(self, anchor_ns: int, period_ns: int, n_channels: int, quality: int) -> None:
        self.anchor_ns, self._period_ns = anchor_ns, period_ns
        self._n = 0  # ticks closed
        self._held = np.full(n_channels, np.nan)  # of the last tick closed
        self._is_after_gap = quality == _GAP
        self._held_quality = np.full(n_channels, quality, dtype=np.uint8)
        # channel, time from the anchor and value of what came, each (n,)
        self._kept: list[tuple[IntArray, IntArray, FloatArray]] = [(_NONE, _NONE, np.empty(0))]

    def open_tick(self, newest_ns: int) -> int:
        """Return the number of the open tick, counted from 0."""
        return max(0, (newest_ns - self.anchor_ns - 1) // self._period_ns)

    def first_ns(self, newest_ns: IntArray) -> IntArray:
        """Return the first time of the tick that is open at each newest time, (n,)."""
        tick = np.maximum((newest_ns - self.anchor_ns - 1) // self._period_ns, 0)
        return np.asarray(self.anchor_ns + tick * self._period_ns + (tick > 0))

    def keep(self, channels: Sequence[int], t_ns: IntArray, values: FloatArray) -> None:
        """Take values, (n_channels, m), received at ``t_ns``, (m,), in the order of the log."""
        if len(t_ns):
            numbers = np.array(channels, dtype=np.int64).repeat(len(t_ns))
            t_ns = np.concatenate([t_ns - self.anchor_ns] * len(channels))
            self._kept.append((numbers, t_ns, values.ravel()))

    def close(
        self, until: int, received_ns: IntArray, timeouts_ns: IntArray, *, off_bus: bool
    ) -> tuple[FloatArray, QualityArray]:
        """Close the ticks before ``until``; return values and quality, both (n, n_channels).

        received_ns : when each channel's last value came; moved on
        off_bus : whether the monitor itself hears nothing
        """
        n, n_channels = until - self._n, len(timeouts_ns)
        if n <= 0:
            none = np.empty((0, n_channels))
            return none, none.astype(np.uint8)
        end_ns = np.arange(self._n + 1, until + 1, dtype=np.int64)[:, np.newaxis] * self._period_ns
        shape, size = (n, n_channels), n * n_channels
        place, t_ns, data = self._taken(int(end_ns[-1, 0]), n_channels)
        good, grade = np.isfinite(data), np.zeros(size, dtype=np.uint8)
        n_came = count = np.bincount(place, minlength=size)
        total = np.bincount(place, weights=data, minlength=size)  # sums in order
        if not good.all():
            count = np.bincount(place[good], minlength=size)
            total = np.bincount(place[good], weights=data[good], minlength=size)
            grade[place[np.isnan(data)]] = Quality.INVALID
            grade[place[np.isinf(data)]] = Quality.OUT_OF_RANGE
            grade[count > 0] = Quality.GOOD
        mean = np.divide(total, count, out=np.full(size, np.nan), where=count > 0)
        last_ns = np.zeros(size, dtype=np.int64)
        last_ns[place] = t_ns  # of several in one tick the last stays
        # the place of each channel's last values up to every tick, -1 before the first
        source = np.where(n_came > 0, np.arange(size), -1).reshape(shape)
        came = source >= 0
        np.maximum.accumulate(source, axis=0, out=source)
        begun = source >= 0
        np.maximum(source, 0, out=source)
        values = np.where(begun, mean.take(source), self._held)
        quality = np.where(begun, grade.take(source), self._held_quality)
        heard_ns = np.where(begun, last_ns.take(source), received_ns - self.anchor_ns)
        old = ~came & (end_ns - heard_ns > timeouts_ns)
        if old.any():
            silent = np.full(shape, _OFF_BUS if off_bus else _STALE, dtype=np.uint8)
            if self._is_after_gap and not off_bus:
                silent[end_ns <= timeouts_ns] = _GAP
            values[old], quality[old] = np.nan, silent[old]
        received_ns[:] = heard_ns[-1] + self.anchor_ns
        self._n = until
        self._held, self._held_quality = values[-1].copy(), quality[-1].copy()
        return values, quality

    def _taken(self, end_ns: int, n_channels: int) -> tuple[IntArray, IntArray, FloatArray]:
        """Return place, time and value of all that came up to a time; keep the rest."""
        numbers, t_ns, data = map(np.concatenate, zip(*self._kept, strict=True))
        is_in = t_ns <= end_ns
        self._kept = [(numbers[~is_in], t_ns[~is_in], data[~is_in])]
        numbers, t_ns, data = numbers[is_in], t_ns[is_in], data[is_in]
        tick = np.maximum((t_ns + self._period_ns - 1) // self._period_ns, 1) - 1 - self._n
        return tick * n_channels + numbers, t_ns, data

    def note_times(self, received_ns: IntArray) -> None:
        """Note when the values of the open tick came, which a break forgets."""
        for numbers, t_ns, _ in self._kept:
            received_ns[numbers] = self.anchor_ns + t_ns


def assemble_arrays(
    frame_times_ns: IntArray,
    series: Sequence[Series],
    channels: Sequence[str],
    names: Sequence[str],
    *,
    period_ns: int,
    timeouts_ns: Sequence[int],
    derived: Sequence[Derived] = (),
    longest_ns: int = MAX_JUMP_NS,
) -> SampleBlock:
    """Return all samples of a recording whose frames are in the order of time.

    frame_times_ns : (n,) times of all frames, wanted or not, never decreasing
    series : for each channel the times, among those of the frames, and the values; NaN is not
        available, infinite is out of range
    channels, names, period_ns, timeouts_ns, derived : as for ``BlockAssembler``
    longest_ns : a longer time without any frame is a pause of the recording, of which nothing is
        known; above MAX_JUMP_NS it is a break anyway
    Raises SignalMapError if times decrease, or as ``BlockAssembler``.
    """
    if len(series) != len(channels):
        raise SignalMapError(f"{len(channels)} channels have {len(series)} series")
    assembler = BlockAssembler(channels, names, period_ns, timeouts_ns, derived)
    steps_ns = np.diff(frame_times_ns)
    if np.any(steps_ns < 0):
        raise SignalMapError("the times of the frames decrease")
    pauses = np.flatnonzero(steps_ns > min(longest_ns, MAX_JUMP_NS))
    kinds = [Quality.STALE if steps_ns[k] > MAX_JUMP_NS else Quality.GAP for k in pauses.tolist()]
    cuts = [0, *(pauses + 1).tolist(), len(frame_times_ns)]
    blocks: list[SampleBlock] = []
    for (begin, end), kind in zip(pairwise(cuts), [Quality.STALE, *kinds], strict=True):
        if begin < end:
            t_ns = frame_times_ns[begin:end]
            blocks += assembler.begin(int(t_ns[0]), kind, is_jump=True)
            blocks.append(assembler.push(t_ns, _decoded(t_ns, series)))
    return joined(blocks, len(names))


def _decoded(t_ns: IntArray, series: Sequence[Series]) -> Iterator[Decoded]:
    """Yield the values of each channel within the times of frames, (n,)."""
    for channel, (times_ns, values) in enumerate(series):
        first, last = (
            np.searchsorted(times_ns, t_ns[0]),
            np.searchsorted(times_ns, t_ns[-1], "right"),
        )
        rows = np.searchsorted(t_ns, times_ns[first:last])
        yield Decoded(rows, (channel,), values[np.newaxis, first:last])


def check_grid(period_ns: int) -> None:
    """Raise SignalMapError if ``period_ns`` cannot be the period of a grid."""
    if not 0 < period_ns <= MAX_JUMP_NS:
        raise SignalMapError(
            f"a sample period of {period_ns / 1e9:g} s, above 0 and at most "
            f"{MAX_JUMP_NS / 1e9:g} s is wanted"
        )


def joined(blocks: Sequence[SampleBlock], n_names: int) -> SampleBlock:
    """Return blocks one after the other."""
    if len(blocks) == 1:
        return blocks[0]
    if not blocks:
        none = np.empty((0, n_names))
        return SampleBlock(_NONE, _NONE, none, none.astype(np.uint8))
    return SampleBlock(*(np.concatenate(column) for column in zip(*blocks, strict=True)))
