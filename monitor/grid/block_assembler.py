"""The assembler for whole recordings: the samples of ``assemble.Assembler``, bit for bit.

Frames come in blocks, in the order of the log. Their times are looked at in a few passes: where
they rise, every frame is in time; where some do not, those older than the open tick are found by
the newest time before each. A property test holds the two assemblers together.
"""

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np

from monitor.base.errors import SignalMapError
from monitor.base.types import BoolArray, FloatArray, IntArray, Quality, QualityArray, SampleBlock
from monitor.decode.block_decoder import BlockDecoder, Decoded
from monitor.decode.signal_map import Derived
from monitor.grid.assembler import MAX_JUMP_NS, MAX_LATE, AssemblerCounters, check_grid
from monitor.grid.derived import Output

Series = tuple[IntArray, FloatArray]  # times and values of one channel, both (n,)
_NONE = np.empty(0, dtype=np.int64)


class BlockAssembler:
    """Collects the values of frames into the samples of one recording.

    channels, names, period_ns, timeouts_ns, derived : as for ``Assembler``
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
        self._period_ns, self._timeouts_ns = period_ns, timeouts_ns
        self._output = Output(channels, names, derived)
        self._n_names = len(names)
        self._received_ns = [0] * len(channels)  # time of each channel's last value
        self._blocks: list[SampleBlock] = []
        self._n = 0  # samples in them
        self._segment: _Segment | None = None
        self._newest_ns = 0  # time in the segment
        self._late_in_a_row = 0
        self._is_off_bus = False

    @classmethod
    def of(cls, decoder: BlockDecoder, period_ns: int) -> "BlockAssembler":
        """Return an assembler for what ``decoder`` yields."""
        return cls(decoder.channels, decoder.names, period_ns, decoder.timeouts_ns, decoder.derived)

    @property
    def complete(self) -> int:
        """Return how many samples are complete, those that mark breaks included."""
        return self._n + (self._segment.open_tick(self._newest_ns) if self._segment else 0)

    def set_off_bus(self, is_off_bus: bool) -> None:
        """Say whether the monitor itself hears nothing, from the last frame pushed on."""
        self._is_off_bus = is_off_bus
        if self._segment:
            self._segment.off_bus.append((self._segment.open_tick(self._newest_ns), is_off_bus))

    def push(self, t_ns: IntArray, decoded: Iterable[Decoded] = ()) -> None:
        """Take the times of a block's frames, (n,), wanted or not, and what they say."""
        parts = list(decoded)
        begin = 0
        while begin < len(t_ns):
            if self._segment is None:
                self._anchor(int(t_ns[begin]))
            segment = self._segment
            assert segment is not None
            stop, late, is_jump = self._until_break(segment, t_ns[begin:])
            for part in parts:
                inside = slice(*np.searchsorted(part.rows, (begin, begin + stop)).tolist())
                rows, values = part.rows[inside], part.values[:, inside]
                if late.size:
                    kept = ~np.isin(rows, late + begin)
                    rows, values = rows[kept], values[:, kept]
                segment.keep(part.channels, t_ns[rows], values)
            begin += stop
            if begin < len(t_ns):
                self._break(segment, int(t_ns[begin]), is_jump=is_jump)

    def finish(self) -> SampleBlock:
        """Return all samples; the tick that is still open gives none."""
        if self._segment is not None:
            self._close(self._segment, self._segment.open_tick(self._newest_ns))
            self._segment = None
        return joined(self._blocks, self._n_names)

    def _until_break(self, segment: "_Segment", t_ns: IntArray) -> tuple[int, IntArray, bool]:
        """Return how many frames come before a break, which of them are late, and if it is a jump.

        Moves the newest time, counts what is late; t_ns : (n,) at least one
        """
        own_ns = t_ns[1:] - t_ns[:-1]
        first_ns = int(t_ns[0]) - self._newest_ns
        least_ns = min(first_ns, int(own_ns.min(initial=0)))
        if least_ns >= 0 and max(first_ns, int(own_ns.max(initial=0))) <= MAX_JUMP_NS:
            self._newest_ns, self._late_in_a_row = int(t_ns[-1]), 0
            return len(t_ns), _NONE, False
        steps_ns = np.concatenate([[first_ns], own_ns])
        if least_ns >= 0:
            jumps = np.flatnonzero(steps_ns > MAX_JUMP_NS)
            stop = int(jumps[0]) if jumps.size else len(t_ns)
            if stop:
                self._newest_ns, self._late_in_a_row = int(t_ns[stop - 1]), 0
            return stop, _NONE, True
        newest_ns = np.maximum.accumulate(np.concatenate([[self._newest_ns], t_ns]))
        before_ns = newest_ns[:-1]
        older = np.flatnonzero(t_ns < before_ns)
        late = older[t_ns[older] < segment.first_ns(before_ns[older])]
        jumps = np.flatnonzero(t_ns - before_ns > MAX_JUMP_NS)
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

    def _anchor(self, t_ns: int) -> None:
        self._segment = _Segment(t_ns, self._period_ns, off_bus=self._is_off_bus)
        self._newest_ns, self._late_in_a_row = t_ns, 0

    def _break(self, segment: "_Segment", t_ns: int, *, is_jump: bool) -> None:
        """Anchor the grid anew after a sample that marks the break."""
        self._close(segment, segment.open_tick(self._newest_ns) + is_jump)
        self.counters.discontinuities += 1
        self._anchor(t_ns)
        quality = np.full((1, self._n_names), int(Quality.STALE), dtype=np.uint8)
        self._add(np.array([t_ns], dtype=np.int64), np.full(quality.shape, np.nan), quality)

    def _close(self, segment: "_Segment", n: int) -> None:
        """Add the first ``n`` ticks of a segment."""
        values, quality = segment.close(n, self._received_ns, self._timeouts_ns)
        t_ns = segment.anchor_ns + np.arange(1, n + 1, dtype=np.int64) * self._period_ns
        self._add(t_ns, *self._output.of_arrays(values, quality))

    def _add(self, t_ns: IntArray, values: FloatArray, quality: QualityArray) -> None:
        index = np.arange(self._n + 1, self._n + 1 + len(t_ns), dtype=np.int64)
        self._blocks.append(SampleBlock(index, t_ns, values, quality))
        self._n += len(t_ns)

    def add_series(self, t_ns: IntArray, series: Sequence[Series]) -> None:
        """Take a whole stretch without a break, (n,) never falling, and each channel's values."""
        if self._segment is None:
            self._anchor(int(t_ns[0]))
        else:
            self._break(self._segment, int(t_ns[0]), is_jump=True)
        segment, self._newest_ns = self._segment, int(t_ns[-1])
        assert segment is not None
        for channel, (times_ns, values) in enumerate(series):
            inside = slice(
                np.searchsorted(times_ns, t_ns[0], "left"),
                np.searchsorted(times_ns, t_ns[-1], "right"),
            )
            segment.keep((channel,), times_ns[inside], values[np.newaxis, inside])


class _Segment:
    """The grid between two breaks, and what was received in it."""

    def __init__(self, anchor_ns: int, period_ns: int, *, off_bus: bool) -> None:
        self.anchor_ns, self._period_ns = anchor_ns, period_ns
        self.off_bus = [(0, off_bus)]  # from which tick on, counted from 0
        self._kept: dict[tuple[int, ...], list[Series]] = {}

    def open_tick(self, newest_ns: int) -> int:
        """Return the number of the open tick, counted from 0."""
        return max(0, (newest_ns - self.anchor_ns - 1) // self._period_ns)

    def first_ns(self, newest_ns: IntArray) -> IntArray:
        """Return the first time of the tick that is open at each newest time, (n,)."""
        tick = np.maximum((newest_ns - self.anchor_ns - 1) // self._period_ns, 0)
        return np.asarray(self.anchor_ns + tick * self._period_ns + (tick > 0))

    def keep(self, channels: tuple[int, ...], t_ns: IntArray, values: FloatArray) -> None:
        """Take values, (n_channels, m), received at ``t_ns``, (m,), in the order of the log."""
        if len(t_ns):
            self._kept.setdefault(channels, []).append((t_ns - self.anchor_ns, values))

    def close(
        self, n: int, received_ns: list[int], timeouts_ns: Sequence[int]
    ) -> tuple[FloatArray, QualityArray]:
        """Return values and quality of the first ``n`` ticks, both (n, n_channels).

        received_ns : when each channel's last value before the segment came; moved on
        """
        values = np.full((n, len(timeouts_ns)), np.nan)
        quality = np.full(values.shape, int(Quality.STALE), dtype=np.uint8)
        off = np.zeros(n, dtype=np.bool_)
        for tick, is_off in self.off_bus:
            off[tick:] = is_off
        end_ns = np.arange(1, n + 1, dtype=np.int64) * self._period_ns
        if off.any():
            for channel, timeout_ns in enumerate(timeouts_ns):
                age_ns = end_ns - (received_ns[channel] - self.anchor_ns)
                quality[off & (age_ns > timeout_ns), channel] = Quality.OFF_BUS
        for channels, parts in self._kept.items():
            t_ns = np.concatenate([t for t, _ in parts])
            data = np.concatenate([each for _, each in parts], axis=1)
            tick = np.maximum((t_ns + self._period_ns - 1) // self._period_ns, 1) - 1
            n_inside = _n_before(tick, n)
            came = _Came(tick[:n_inside], t_ns[:n_inside], end_ns, off)
            for channel, each in zip(channels, data, strict=True):
                came.fill(
                    each[:n_inside], timeouts_ns[channel], values[:, channel], quality[:, channel]
                )
                received_ns[channel] = self.anchor_ns + int(t_ns[-1])
        return values, quality


class _Came:
    """When the values of one message came within the ticks of a segment."""

    def __init__(self, tick: IntArray, t_ns: IntArray, end_ns: IntArray, off: BoolArray) -> None:
        n = len(end_ns)
        self._tick, self._off = tick, off
        self._count = np.bincount(tick, minlength=n)
        self._came = self._count > 0
        self._source = np.maximum.accumulate(np.where(self._came, np.arange(n), -1))
        last_ns = np.zeros(n, dtype=np.int64)
        last_ns[tick] = t_ns  # of several in one tick the last stays
        self._age_ns = end_ns - last_ns[self._source]

    def fill(
        self, data: FloatArray, timeout_ns: int, values: FloatArray, quality: QualityArray
    ) -> None:
        """Fill one channel's ticks, (n,), from the first value on."""
        n, tick, count = len(values), self._tick, self._count
        good = np.isfinite(data)
        grade = np.zeros(n, dtype=np.uint8)
        if good.all():
            total = np.bincount(tick, weights=data, minlength=n)  # sums in order
        else:
            count = np.bincount(tick[good], minlength=n)
            total = np.bincount(tick[good], weights=data[good], minlength=n)
            grade[tick[np.isnan(data)]] = Quality.INVALID
            grade[tick[np.isinf(data)]] = Quality.OUT_OF_RANGE
            grade[count > 0] = Quality.GOOD
        mean = np.divide(total, count, out=np.full(n, np.nan), where=count > 0)
        begun = self._source >= 0
        np.copyto(values, mean[self._source], where=begun)
        np.copyto(quality, grade[self._source], where=begun)
        old = begun & ~self._came & (self._age_ns > timeout_ns)
        values[old] = np.nan
        quality[old] = np.where(self._off[old], int(Quality.OFF_BUS), int(Quality.STALE))


def _n_before(tick: IntArray, n: int) -> int:
    """Return how many values came before tick ``n``; ticks never fall."""
    return int(np.searchsorted(tick, n))


def assemble_arrays(
    frame_times_ns: IntArray,
    series: Sequence[Series],
    channels: Sequence[str],
    names: Sequence[str],
    *,
    period_ns: int,
    timeouts_ns: Sequence[int],
    derived: Sequence[Derived] = (),
) -> SampleBlock:
    """Return all samples of a recording whose frames are in the order of time.

    frame_times_ns : (n,) times of all frames, wanted or not, never decreasing
    series : for each channel the times, among those of the frames, and the values; NaN is not
        available, infinite is out of range
    channels, names, period_ns, timeouts_ns, derived : as for ``Assembler``
    Raises SignalMapError if times decrease, or as ``Assembler``.
    """
    if len(series) != len(channels):
        raise SignalMapError(f"{len(channels)} channels have {len(series)} series")
    assembler = BlockAssembler(channels, names, period_ns, timeouts_ns, derived)
    steps_ns = np.diff(frame_times_ns)
    if np.any(steps_ns < 0):
        raise SignalMapError("the times of the frames decrease")
    cuts = [0, *(np.flatnonzero(steps_ns > MAX_JUMP_NS) + 1).tolist(), len(frame_times_ns)]
    for begin, end in pairwise(cuts):
        if begin < end:
            assembler.add_series(frame_times_ns[begin:end], series)
    return assembler.finish()


def joined(blocks: Sequence[SampleBlock], n_names: int) -> SampleBlock:
    """Return blocks one after the other."""
    if not blocks:
        none = np.empty((0, n_names))
        return SampleBlock(_NONE, _NONE, none, none.astype(np.uint8))
    return SampleBlock(*(np.concatenate(column) for column in zip(*blocks, strict=True)))
