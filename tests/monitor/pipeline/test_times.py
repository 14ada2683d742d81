"""Times of a log's frames: a clock that steps and wrong stamps set no code, true silence does.

The long form is the benchmark ``fuzz_times``.
"""

import random
from collections.abc import Sequence
from itertools import pairwise
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from benchmarks.damage.fuzz_times import (
    BEGIN_NS,
    DriveFindings,
    S,
    healthy,
    jumping,
    replayed,
    without_counters,
)
from monitor.base import config
from monitor.base.types import FrameBlock
from monitor.decode.block_decoder import BlockDecoder
from monitor.frames.blocks import chosen, joined
from monitor.grid import time_walk, timeline
from monitor.grid.timeline import Timeline
from monitor.pipeline import replay
from tests.helpers.logs.batch_logs import MS
from tests.helpers.logs.injected_frames import LAMBDA_ID

SETUP = replay.set_up(None, (), config.load())
BARE = without_counters(SETUP)  # the same map without alive counters
DRIVE = healthy(60.0)
UNTOUCHED = replayed(DRIVE, SETUP)
MIDDLE = len(DRIVE.t_ns) // 2
FOREIGN = 0x333


def later(frames: FrameBlock, place: int, step_s: float, n: int | None = None) -> FrameBlock:
    """Return frames of which those from a place on, or n of them, are stamped later."""
    t_ns = frames.t_ns.copy()
    t_ns[place : None if n is None else place + n] += round(step_s * S)
    return frames._replace(t_ns=t_ns)


def without(frames: FrameBlock, begin_s: float, end_s: float) -> FrameBlock:
    t_s = (frames.t_ns - BEGIN_NS) / S
    return chosen(frames, (t_s < begin_s) | (t_s >= end_s))


def counts(found: DriveFindings) -> tuple[int, int, int]:
    return found.times.clock_steps, found.times.log_gaps, found.times.outliers


@pytest.mark.parametrize("step_s", [0.5, 59.0, 61.0, -1.0, -3600.0])
def test_a_clock_that_steps_while_the_alive_counters_go_on_changes_nothing(step_s: float) -> None:
    found = replayed(later(DRIVE, MIDDLE, step_s), SETUP)
    assert (found.codes, found.cycles, counts(found)) == ((), 0, (1, 0, 0))
    assert found.judged["samples"] == UNTOUCHED.judged["samples"]


@pytest.mark.parametrize("step_s", [3.0, 3600.0])
def test_without_alive_counters_a_pause_ends_the_window_without_a_code(step_s: float) -> None:
    found = replayed(later(DRIVE, MIDDLE, step_s), BARE)
    assert (found.codes, found.cycles, counts(found)) == ((), 0, (0, 1, 0))
    # 26 of them in a row would be a code, were they silence
    many = DRIVE
    for place in range(MIDDLE, MIDDLE + 2000, 30):
        many = later(many, place, step_s)
    found = replayed(many, BARE)
    assert (found.codes, found.cycles) == ((), 0)
    assert found.times.log_gaps > 60


@pytest.mark.parametrize("places", [(0, 1, 2), (0, 50, 3000)])
def test_frames_stamped_wrongly_set_no_code_and_begin_no_cycle(places: Sequence[int]) -> None:
    wrong = DRIVE
    for place, step_s in zip(places, (4.0, 3600.0, 4.0), strict=True):
        wrong = later(wrong, MIDDLE + place, step_s, n=1)
    found = replayed(wrong, SETUP)
    assert (found.codes, found.cycles, counts(found)) == ((), 0, (0, 0, 3))
    assert found.judged["samples"] == UNTOUCHED.judged["samples"]


@pytest.mark.parametrize("pause_s", [3.0, 25.0])
def test_a_pause_of_a_whole_log_is_no_silence_of_the_ecu(pause_s: float) -> None:
    # GIVEN a log whose logger stalled, so that its alive counters miss frames
    found = replayed(without(DRIVE, 30.0, 30.0 + pause_s), SETUP)
    assert (found.codes, counts(found)) == ((), (0, 1, 0))


@settings(max_examples=6, deadline=None)
@given(
    cuts=st.lists(st.integers(100, 3000), min_size=2, max_size=6, unique=True),
    chance=st.randoms(use_true_random=False),
)
@example(cuts=[600, 1200, 1800], chance=random.Random(1))
def test_stretches_in_another_order_set_no_code(cuts: list[int], chance: random.Random) -> None:
    edges = [0, *sorted(cuts), 4000]
    stretches = [chosen(DRIVE, slice(*edge)) for edge in pairwise(edges)]
    chance.shuffle(stretches)
    found = replayed(joined([*stretches, chosen(DRIVE, slice(4000, None))]), SETUP)
    assert (found.codes, found.cycles) == ((), 0)


@pytest.mark.parametrize("size", [97, 1000])
def test_a_clock_that_stepped_long_ago_is_still_reckoned_with(size: int) -> None:
    # GIVEN steps and a wrong stamp, and behind them more frames than the timeline holds back
    spoilt = later(later(later(DRIVE, 2000, -3600.0), 4000, 59.0), 6000, 4.0, n=1)
    with patch.object(timeline, "KEPT", 300), patch.object(time_walk, "KEPT", 300):
        found = replayed(spoilt, SETUP, size)
    assert (found.codes, found.cycles, counts(found)) == ((), 0, (2, 0, 1))
    assert found.judged["samples"] == UNTOUCHED.judged["samples"]


def test_a_log_written_in_batches_of_half_a_second_is_told() -> None:
    in_batches = DRIVE._replace(t_ns=BEGIN_NS + (DRIVE.t_ns - BEGIN_NS) // (S // 2) * (S // 2))
    for frames, told in ((in_batches, "frames written in batches"), (DRIVE, "")):
        timeline = Timeline(BlockDecoder(SETUP.bus_map, SETUP.bus_map.names))
        for _ in timeline.blocks([frames]):
            pass
        assert told in "".join(timeline.notes)
        assert bool(timeline.notes) == bool(told)


@pytest.mark.parametrize("rate", [20.0, 130.0, 400.0])
def test_a_clock_that_runs_fast_for_a_moment_sets_no_code(rate: float) -> None:
    t_s = (DRIVE.t_ns - BEGIN_NS) / S
    fast_s = np.clip(t_s - 30.0, 0.0, 0.3) * (rate - 1.0)
    frames = DRIVE._replace(t_ns=DRIVE.t_ns + np.round(fast_s * S).astype(np.int64))
    for setup in (SETUP, BARE):
        found = replayed(frames, setup)
        assert (found.codes, found.cycles) == ((), 0)


@pytest.mark.parametrize("has_counters", [True, False])
def test_a_pause_of_more_than_a_minute_is_a_break_in_the_recording(has_counters: bool) -> None:
    # GIVEN a log with a hole, in which its logger or its ECU was off
    first, second = chosen(DRIVE, slice(0, MIDDLE)), chosen(DRIVE, slice(MIDDLE + 5, None))
    for pause_s in (61.0, 3600.0):
        later_ns = second.t_ns + round(pause_s * S)
        both = joined([first, second._replace(t_ns=later_ns)])
        # WHEN it is replayed THEN nothing is missed; counters tell an ECU that was off for long
        found = replayed(both, SETUP if has_counters else BARE)
        assert found.codes == ()
        assert found.cycles == (has_counters and pause_s > 100.0)
        assert abs(found.judged["samples"] - UNTOUCHED.judged["samples"]) <= 5


@pytest.mark.parametrize("period_s", [0.005, 0.1, 1.0])
@pytest.mark.parametrize("has_counters", [True, False])
def test_mapped_messages_that_are_silent_while_any_other_goes_on_are_missed(
    period_s: float, has_counters: bool
) -> None:
    # GIVEN a bus with a message that no map knows
    t_ns = BEGIN_NS + 1 * MS + np.arange(round(60 / period_s)) * round(period_s * S)
    other = FrameBlock(
        t_ns,
        np.full(len(t_ns), FOREIGN, np.uint32),
        np.full(len(t_ns), 8, np.uint8),
        np.zeros((len(t_ns), DRIVE.data.shape[1]), np.uint8),
    )
    silent = without(DRIVE, 30.0, 40.0)
    no_lambda = chosen(DRIVE, (DRIVE.key != LAMBDA_ID) | (DRIVE.t_ns < BEGIN_NS + 30 * S))
    # WHEN all mapped messages or one of them are silent meanwhile THEN that is no gap of the log
    for ecu in (silent, no_lambda):
        both = joined([ecu, other])
        found = replayed(
            chosen(both, np.argsort(both.t_ns, kind="stable")), SETUP if has_counters else BARE
        )
        assert (found.codes, counts(found)) == (("U0100",), (0, 0, 0))


def test_an_engine_start_behind_a_pause_of_the_log_still_begins_a_driving_cycle() -> None:
    # GIVEN two drives in one log, ten minutes between them, the ECU's counters anew
    second = DRIVE._replace(t_ns=DRIVE.t_ns + 660 * S)
    found = replayed(joined([chosen(DRIVE, slice(0, -3)), second]), SETUP)
    assert (found.codes, found.cycles) == ((), 1)


@settings(max_examples=12, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    rate=st.sampled_from([1e-4, 1e-3, 1e-2, 0.1]),
    kind=st.sampled_from(["steps", "stamps", "both"]),
    has_counters=st.booleans(),
)
def test_no_clock_and_no_stamps_set_a_code_or_begin_a_driving_cycle(
    seed: int, rate: float, kind: str, has_counters: bool
) -> None:
    frames = jumping(healthy(30.0), np.random.default_rng(seed), rate, kind)
    setup = SETUP if has_counters else BARE
    found = replayed(frames, setup)
    assert (found.codes, found.cycles) == ((), 0)
    # no result depends on where blocks begin
    again = replayed(frames, setup, size=997)
    assert (again.judged, again.times) == (found.judged, found.times)
