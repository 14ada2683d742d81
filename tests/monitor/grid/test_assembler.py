"""The sample grid: means, holding, timeouts, breaks; blocks give what its rules say."""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from monitor.base.errors import SignalMapError
from monitor.base.types import Quality, Sample, SampleBlock
from monitor.decode.block_decoder import Decoded
from monitor.decode.signal_map import Derived
from monitor.grid.block_assembler import (
    MAX_JUMP_NS,
    MAX_LATE,
    AssemblerCounters,
    BlockAssembler,
    assemble_arrays,
)
from monitor.grid.derived import Output
from tests.helpers.examples import inputs


class SlowAssembler:
    """Takes one frame at a time: its time and the values that it carries, by channel."""

    def __init__(
        self,
        channels: Sequence[str],
        names: Sequence[str],
        period_ns: int,
        timeouts_ns: Sequence[int],
        derived: Sequence[Derived] = (),
    ) -> None:
        n = len(channels)
        self.counters, self.is_off_bus = AssemblerCounters(), False
        self._output, self._n_names = Output(channels, names, derived), len(names)
        self._period_ns, self._timeouts_ns = period_ns, timeouts_ns
        self._came_ns = [0] * n
        self._index, self._late = 0, 0
        self._first_ns: int | None = None  # of the open tick
        self._end_ns = self._newest_ns = 0
        self._gap_ns: int | None = None
        self._forget(Quality.STALE)

    def _forget(self, quality: Quality) -> None:
        n = len(self._came_ns)
        self._values: list[list[float]] = [[] for _ in range(n)]
        self._held, self._quality = [math.nan] * n, [quality] * n

    def push(self, t_ns: int, values: Mapping[int, float]) -> list[Sample]:
        if self._first_ns is None:
            self._anchor(t_ns)
        found = []
        if t_ns - self._newest_ns > MAX_JUMP_NS:
            found = [self._close(), self._break(t_ns, Quality.STALE)]
        elif t_ns < (self._first_ns or 0):
            self.counters.late += 1
            self._late += 1
            if self._late < MAX_LATE:
                return []
            found = [self._break(t_ns, Quality.STALE)]
        self._late = 0
        while t_ns > self._end_ns:
            found.append(self._close())
        self._newest_ns = max(self._newest_ns, t_ns)
        for channel, value in values.items():
            self._values[channel].append(value)
            self._came_ns[channel] = t_ns
        return found

    def gap(self, t_ns: int) -> list[Sample]:
        is_first, self._late = self._first_ns is None, 0
        if is_first:
            self._anchor(t_ns)
            return []
        return [self._break(t_ns, Quality.GAP)]

    def _anchor(self, t_ns: int) -> None:
        self._first_ns = self._newest_ns = t_ns
        self._end_ns = t_ns + self._period_ns

    def _break(self, t_ns: int, quality: Quality) -> Sample:
        self.counters.discontinuities += 1
        self._forget(quality)
        self._anchor(t_ns)
        self._gap_ns = t_ns if quality == Quality.GAP else None
        self._index += 1
        marks = np.full(self._n_names, quality, dtype=np.uint8)
        return Sample(self._index, t_ns, np.full(self._n_names, math.nan), marks)

    def _close(self) -> Sample:
        end_ns = self._end_ns
        for channel, values in enumerate(self._values):
            good = [value for value in values if math.isfinite(value)]
            timeout_ns = self._timeouts_ns[channel]
            if good:
                total = 0.0
                for value in good:
                    total += value
                self._held[channel] = total / len(good)
                self._quality[channel] = Quality.GOOD
            elif values:
                self._held[channel] = math.nan
                is_out = any(map(math.isinf, values))
                self._quality[channel] = Quality.OUT_OF_RANGE if is_out else Quality.INVALID
            elif end_ns - self._came_ns[channel] > timeout_ns:
                self._held[channel] = math.nan
                is_new = self._gap_ns is not None and end_ns - self._gap_ns <= timeout_ns
                self._quality[channel] = Quality.GAP if is_new else Quality.STALE
                if self.is_off_bus:
                    self._quality[channel] = Quality.OFF_BUS
        self._values = [[] for _ in self._values]
        held, quality = np.array([self._held]), np.array([self._quality], dtype=np.uint8)
        values, marks = self._output.of(held, quality)
        self._index += 1
        self._first_ns, self._end_ns = end_ns + 1, end_ns + self._period_ns
        return Sample(self._index, end_ns, values[0], marks[0])


MS = 1_000_000
S = 1_000 * MS


def decoded(frames: Sequence[Mapping[int, float]]) -> list[Decoded]:
    """Return the values of frames, by channel, as a decoder does, each channel's together."""
    parts = []
    for channel in sorted({channel for frame in frames for channel in frame}):
        rows = [row for row, frame in enumerate(frames) if channel in frame]
        values = np.array([[frames[row][channel] for row in rows]])
        parts.append(Decoded(np.array(rows), (channel,), values))
    return parts


def singly(block: SampleBlock) -> list[Sample]:
    rows = zip(block.index.tolist(), block.t_ns.tolist(), block.values, block.quality, strict=True)
    return [Sample(*row) for row in rows]


def bits(samples: Sequence[Sample]) -> list[tuple[int, int, bytes, bytes]]:
    return [(s.index, s.t_ns, s.values.tobytes(), s.quality.tobytes()) for s in samples]


@pytest.mark.parametrize("period_ns", [0, -5, MAX_JUMP_NS + 1])
def test_an_impossible_period_is_refused(period_ns: int) -> None:
    with pytest.raises(SignalMapError, match="sample period"):
        BlockAssembler(["x"], ["x"], period_ns, [S])


CHANNELS, NAMES = ["flow", "speed", "x"], ["x", "fuel_mass_mg", "speed"]
RECIPE = Derived("fuel_mass_mg", 3.7, ("flow",), ("speed",))
TIMEOUTS_NS = [150 * MS, 1000 * MS, 30 * MS]

values = st.one_of(
    st.sampled_from([math.nan, math.inf, 0.0]), st.floats(-1e6, 1e6, allow_nan=False)
)
carried = st.dictionaries(st.integers(0, 2), values)
rising = st.sampled_from([0, 1, 7, 20, 50, 99, 100, 101, 250, 900, 60_000, 60_001, 200_000])
arrivals = st.lists(st.tuples(rising, carried), max_size=60)
periods = st.sampled_from([10, 100, 333, 60_000])
starts = st.sampled_from([-5, 0, 9, 1_700_000_000_000])  # ms; the last one since 1970


@inputs(300)
@given(arrivals=arrivals, period_ms=periods, start=starts)
def test_whole_recordings_give_the_same_bits_as_frame_by_frame(
    arrivals: list[tuple[int, dict[int, float]]], period_ms: int, start: int
) -> None:
    t_ns = (np.cumsum([start, *(step for step, _ in arrivals)])[1:] * MS).astype(np.int64)
    frames = [frame for _, frame in arrivals]
    reference = SlowAssembler(CHANNELS, NAMES, period_ms * MS, TIMEOUTS_NS, [RECIPE])
    expected = [
        s for t, frame in zip(t_ns.tolist(), frames, strict=True) for s in reference.push(t, frame)
    ]
    rows = [[k for k, frame in enumerate(frames) if i in frame] for i in range(len(CHANNELS))]
    block = assemble_arrays(
        t_ns,
        [(t_ns[at], np.array([frames[k][i] for k in at])) for i, at in enumerate(rows)],
        CHANNELS,
        NAMES,
        period_ns=period_ms * MS,
        timeouts_ns=TIMEOUTS_NS,
        derived=[RECIPE],
    )
    assert bits(singly(block)) == bits(expected)


steps = st.one_of(rising, st.sampled_from([-1, -30, -99, -150, -5000, -400_000]))
unruly = st.lists(
    st.tuples(steps, carried, st.sampled_from(["", "", "", "", "", "gap", "late"])), max_size=40
)


FALLEN = [(0, {2: 1.0}, ""), *[(-5000, {2: 2.0}, "late")] * 2, (101, {}, "")]  # to an earlier time


@inputs(300)
@example(FALLEN, 100, 9, [50])
@given(unruly, periods, starts, st.lists(st.integers(0, 200), max_size=5))
def test_frames_in_any_order_and_in_any_blocks_give_the_bits_of_the_rules(
    arrivals: list[tuple[int, dict[int, float], str]], period_ms: int, start: int, cuts: list[int]
) -> None:
    # GIVEN frames that step back, that are late in long rows, and gaps of which nothing is known
    times: list[int] = []
    frames: list[dict[int, float]] = []
    gaps: list[int] = []
    newest_ms = start
    for step_ms, frame, kind in arrivals:
        if kind == "gap":
            gaps.append(len(times))
        repeats = MAX_LATE - 2 if kind == "late" else 1
        times += [(newest_ms + step_ms) * MS] * repeats
        frames += [frame] * repeats
        newest_ms = max(newest_ms, newest_ms + step_ms)
    reference = SlowAssembler(CHANNELS, NAMES, period_ms * MS, TIMEOUTS_NS, [RECIPE])
    expected: list[Sample] = []
    for k, (t_ns, frame) in enumerate(zip(times, frames, strict=True)):
        expected += reference.gap(t_ns) if k in gaps else []
        expected += reference.push(t_ns, frame)
    subject = BlockAssembler(CHANNELS, NAMES, period_ms * MS, TIMEOUTS_NS, [RECIPE])
    found: list[Sample] = []
    edges = sorted({0, *(cut for cut in cuts if cut < len(times)), len(times)})
    for begin, end in pairwise(edges):
        inside = [gap - begin for gap in gaps if begin <= gap < end]
        t_ns_of = np.array(times[begin:end], dtype=np.int64)
        found += singly(subject.push(t_ns_of, decoded(frames[begin:end]), inside))
    assert bits(found) == bits(expected)
    assert subject.counters == reference.counters


def test_times_at_both_ends_of_64_bits_are_a_break_and_no_more() -> None:
    subject = BlockAssembler(["x"], ["x"], S, [250 * MS])
    t_ns = np.array([-9_100_000_000, 9_100_000_000, -9_100_000_000], dtype=np.int64) * S
    samples = singly(subject.push(t_ns))
    assert [s.t_ns // S for s in samples] == [-9_099_999_999, 9_100_000_000]
    assert (subject.counters.discontinuities, subject.counters.late) == (1, 1)


def test_frames_out_of_order_are_refused_by_the_array_form() -> None:
    with pytest.raises(SignalMapError, match="decrease"):
        assemble_arrays(np.array([5, 4]), [], [], [], period_ns=100 * MS, timeouts_ns=[])
