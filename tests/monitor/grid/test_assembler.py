import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base.errors import SignalMapError
from monitor.base.types import Quality, Sample, Update
from monitor.decode.signal_map import Derived
from monitor.grid.assembler import MAX_JUMP_NS, MAX_LATE, Assembler
from monitor.grid.block_assembler import assemble_arrays
from tests.helpers.examples import inputs

MS = 1_000_000
S = 1_000 * MS


def assembler(period_ms: int = 100, timeout_ms: int = 250, n: int = 1) -> Assembler:
    names = [f"x{i}" for i in range(n)]
    return Assembler(names, names, period_ms * MS, [timeout_ms * MS] * n)


def push(subject: Assembler, t_ns: int, update: Update | None) -> Sequence[Sample]:
    samples = subject.advance(t_ns)
    if samples is None:
        return ()
    received = subject.received
    for channel, value in zip(*(update or ((), ())), strict=True):
        received.times_ns[channel] = t_ns
        if math.isfinite(value):
            received.sums[channel] += value
            received.goods[channel] += 1
        else:
            bad = Quality.INVALID if math.isnan(value) else Quality.OUT_OF_RANGE
            received.worst[channel] = max(received.worst[channel], bad)
    return samples


def play(subject: Assembler, *arrivals: tuple[int, float | None]) -> list[Sample]:
    samples: list[Sample] = []
    for t_ms, value in arrivals:
        update = None if value is None else ((0,), (value,))
        samples += push(subject, t_ms * MS, update)
    return samples


def test_a_tick_holds_the_mean_of_what_came_since_the_last_tick() -> None:
    samples = play(assembler(), (1000, 1.0), (1040, 2.0), (1100, 6.0), (1101, 9.0))
    assert [(s.index, s.t_ns, s.values.tolist()) for s in samples] == [(1, 1100 * MS, [3.0])]
    assert samples[0].quality.tolist() == [Quality.GOOD]


def test_a_frame_on_the_tick_belongs_to_it_and_the_next_frame_closes_it() -> None:
    subject = assembler()
    assert play(subject, (0, 1.0), (100, 3.0)) == []
    assert play(subject, (101, 0.0))[0].values.tolist() == [2.0]


def test_frames_without_wanted_signals_move_time() -> None:
    assert [s.index for s in play(assembler(), (0, 1.0), (301, None))] == [1, 2, 3]


def test_a_value_is_held_until_its_timeout_then_stale() -> None:
    samples = play(assembler(timeout_ms=250), (0, 5.0), (501, None))
    assert [s.quality[0] for s in samples] == [
        Quality.GOOD,
        Quality.GOOD,
        Quality.STALE,
        Quality.STALE,
        Quality.STALE,
    ]
    assert samples[1].values[0] == 5.0
    assert math.isnan(samples[2].values[0])


def test_good_values_outvote_bad_ones_in_the_same_tick() -> None:
    samples = play(assembler(), (0, math.nan), (10, math.inf), (20, 4.0), (101, None))
    assert samples[0].values.tolist() == [4.0]


@pytest.mark.parametrize(
    ("values", "quality"),
    [
        ([math.nan], Quality.INVALID),
        ([math.inf], Quality.OUT_OF_RANGE),
        ([math.nan, math.inf], Quality.OUT_OF_RANGE),
        ([-math.inf], Quality.OUT_OF_RANGE),
    ],
)
def test_a_tick_with_only_bad_values_says_which(values: list[float], quality: Quality) -> None:
    samples = play(assembler(), *[(i, value) for i, value in enumerate(values)], (101, None))
    assert samples[0].quality.tolist() == [quality]
    assert math.isnan(samples[0].values[0])


def test_a_late_frame_is_counted_and_dropped() -> None:
    subject = assembler()
    play(subject, (0, 1.0), (150, 2.0), (99, 50.0), (100, 50.0))
    samples = play(subject, (201, None))
    assert samples[0].values.tolist() == [2.0]
    assert subject.counters.late == 2


def test_a_clock_that_went_backwards_anchors_the_grid_anew() -> None:
    # GIVEN a drive at 1000 s
    subject = assembler()
    play(subject, (1_000_000, 1.0), (1_000_101, 1.0))
    # WHEN the clock falls to 0 s
    late = [(t, 2.0) for t in range(MAX_LATE)]
    samples = play(subject, *late)
    # THEN the hundredth late frame marks the break and the grid goes on from there
    assert [(s.index, s.t_ns, s.quality.tolist()) for s in samples] == [
        (2, (MAX_LATE - 1) * MS, [Quality.STALE])
    ]
    assert subject.counters.discontinuities == 1
    after = play(subject, (MAX_LATE + 100, None))
    assert [(s.index, s.t_ns, s.values.tolist()) for s in after] == [
        (3, (MAX_LATE + 99) * MS, [2.0])
    ]


def test_single_late_frames_never_anchor_anew() -> None:
    subject = assembler()
    play(subject, (0, 1.0), (250, 1.0))
    for _ in range(3 * MAX_LATE):
        play(subject, (0, 1.0), (250, 1.0))
    assert subject.counters.discontinuities == 0


def test_a_jump_of_more_than_a_minute_is_a_break_and_a_shorter_one_a_gap() -> None:
    subject = assembler(period_ms=1000)
    assert len(play(subject, (0, 1.0), (60_000, 1.0))) == 59
    samples = play(subject, (120_001, 7.0), (121_002, None))
    assert [s.t_ns // MS for s in samples] == [60_000, 120_001, 121_001]
    assert [s.quality[0] for s in samples] == [Quality.GOOD, Quality.STALE, Quality.GOOD]
    assert [s.index for s in samples] == [60, 61, 62]
    assert subject.counters.discontinuities == 1


def test_a_reset_starts_at_tick_one_and_holds_nothing() -> None:
    subject = assembler()
    play(subject, (0, 1.0), (101, 1.0))
    subject.reset()
    samples = play(subject, (5, None), (106, None))
    assert [(s.index, s.t_ns, s.quality.tolist()) for s in samples] == [
        (1, 105 * MS, [Quality.STALE])
    ]


def test_fuel_per_stroke_follows_from_fuel_flow_and_speed() -> None:
    recipe = Derived("fuel_mass_mg", 30000.0, ("flow",), ("speed",))
    subject = Assembler(
        ["flow", "speed"], ["fuel_mass_mg", "speed"], 100 * MS, [S, S], derived=[recipe]
    )
    push(subject, 0, ((0, 1), (2.0, 3000.0)))
    assert push(subject, 101 * MS, ((1,), (0.0,)))[0].values.tolist() == [20.0, 3000.0]
    stopped = push(subject, 201 * MS, None)[0]
    assert stopped.quality.tolist() == [Quality.INVALID, Quality.GOOD]


@pytest.mark.parametrize("period_ns", [0, -5, MAX_JUMP_NS + 1])
def test_an_impossible_period_is_refused(period_ns: int) -> None:
    with pytest.raises(SignalMapError, match="sample period"):
        Assembler(["x"], ["x"], period_ns, [S])


values = st.one_of(
    st.sampled_from([math.nan, math.inf, 0.0, -0.0]), st.floats(-1e6, 1e6, allow_nan=False)
)
arrivals = st.lists(
    st.tuples(
        st.sampled_from([0, 1, 7, 20, 50, 99, 100, 101, 250, 900, 60_000, 60_001, 200_000]),
        st.sets(st.integers(0, 2)),
        st.tuples(values, values, values),
    ),
    max_size=60,
)


@inputs(300)
@given(
    arrivals=arrivals, period_ms=st.sampled_from([10, 100, 333, 60_000]), start=st.integers(-5, 9)
)
def test_whole_recordings_give_the_same_bits_as_frame_by_frame(
    arrivals: list[tuple[int, set[int], tuple[float, float, float]]], period_ms: int, start: int
) -> None:
    channels, names = ["flow", "speed", "x"], ["x", "fuel_mass_mg", "speed"]
    recipe = Derived("fuel_mass_mg", 3.7, ("flow",), ("speed",))
    timeouts = [150 * MS, 1000 * MS, 30 * MS]
    period_ns = period_ms * MS
    subject = Assembler(channels, names, period_ns, timeouts, [recipe])
    expected: list[Sample] = []
    times: list[int] = []
    series: list[tuple[list[int], list[float]]] = [([], []) for _ in channels]
    t_ns = start * MS
    for step_ms, present, triple in arrivals:
        t_ns += step_ms * MS
        indices = tuple(sorted(present))
        update = (indices, tuple(triple[i] for i in indices))
        expected += push(subject, t_ns, update if indices else None)
        times.append(t_ns)
        for i in indices:
            series[i][0].append(t_ns)
            series[i][1].append(triple[i])
    block = assemble_arrays(
        np.array(times, dtype=np.int64),
        [(np.array(t, dtype=np.int64), np.array(v, dtype=np.float64)) for t, v in series],
        channels,
        names,
        period_ns=period_ns,
        timeouts_ns=timeouts,
        derived=[recipe],
    )
    assert block.index.tolist() == [s.index for s in expected]
    assert block.t_ns.tolist() == [s.t_ns for s in expected]
    assert block.values.tobytes() == b"".join(s.values.tobytes() for s in expected)
    assert block.quality.tobytes() == b"".join(s.quality.tobytes() for s in expected)


def test_frames_out_of_order_are_refused_by_the_array_form() -> None:
    with pytest.raises(SignalMapError, match="decrease"):
        assemble_arrays(np.array([5, 4]), [], [], [], period_ns=100 * MS, timeouts_ns=[])
