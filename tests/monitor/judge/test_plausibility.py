"""Tests that need no model: missing, invalid, not ready, out of range, frozen."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base import config
from monitor.base.types import Quality, Sample
from monitor.judge.counters import ticks_to_mature
from monitor.judge.electrical.plausibility import Plausibility, Readiness, Results, TickResult
from monitor.judge.electrical.suite import ActivityTest, Maturing
from monitor.model.card import Channel

CONFIG = config.load()
PERIOD_S = 0.1
NAMES = ("lambda_measured", "sensor_ready", "engine_speed_rpm")
SATURATED = 15.9  # highest lambda that training saw


def sample(
    quality: Quality, ready: float = 1.0, rpm: float = 2000.0, names: tuple[str, ...] = NAMES
) -> Sample:
    measured = 1.0 if quality == Quality.GOOD else math.nan
    held = {"lambda_measured": measured, "sensor_ready": ready, "engine_speed_rpm": rpm}
    row = np.array([held[name] for name in names])
    qualities = np.zeros(len(names), dtype=np.uint8)
    qualities[names.index("lambda_measured")] = quality
    return Sample(0, 0, row, qualities)


class OneByOne(Plausibility):
    def step(self, one: Sample) -> list[TickResult]:
        results = self.push(one.values[np.newaxis], one.quality[np.newaxis])
        assert all((begin, end) == (0, 1) for begin, end, _ in results)
        return [result for _, _, result in results]


def subject(names: tuple[str, ...] = NAMES, period_s: float = PERIOD_S) -> OneByOne:
    return OneByOne(CONFIG.plausibility, names, "lambda_measured", period_s)


def by_test(results: list[TickResult]) -> dict[str, TickResult]:
    found = {result.test: result for result in results}
    assert len(found) == len(results)
    return found


def fails(results: list[TickResult], test: str) -> bool:
    """Return whether a test failed; one that says nothing has not."""
    found = by_test(results)
    return test in found and found[test].failed


def heard(names: tuple[str, ...] = NAMES) -> OneByOne:
    plausibility = subject(names)
    plausibility.step(sample(Quality.GOOD, names=names))
    return plausibility


PASSED = dict.fromkeys(("communication", "ready", "range"))


@pytest.mark.parametrize(
    ("quality", "ready", "said"),
    [
        (Quality.GOOD, 1.0, PASSED),
        (Quality.OUT_OF_RANGE, 1.0, PASSED | {"range": "out_of_range"}),
        # what is not there cannot be in range
        (Quality.STALE, 1.0, {"communication": "signal_missing"}),
        (Quality.STALE, 0.0, {"communication": "signal_missing"}),
        (Quality.STALE, math.nan, {"communication": "signal_missing"}),
        (Quality.INVALID, 1.0, {"communication": "signal_invalid", "ready": None}),
        (Quality.INVALID, 0.0, {"communication": None}),  # nothing yet of one that warms up
    ],
)
def test_a_reading_says_which_test_fails_and_why(
    quality: Quality, ready: float, said: dict[str, str | None]
) -> None:
    results = by_test(heard().step(sample(quality, ready)))
    assert {name: r.fault if r.failed else None for name, r in results.items()} == said


@pytest.mark.parametrize("period_s", [0.01, 0.1, 1.0])
def test_a_sensor_that_is_not_ready_fails_only_after_its_patience(period_s: float) -> None:
    plausibility = subject(period_s=period_s)
    waiting = sample(Quality.INVALID, ready=0.0)
    for _ in range(round(CONFIG.plausibility.not_ready_s / period_s)):
        # nor is it known to pass, so that short drives cannot heal a sensor that never gets ready
        assert "ready" not in by_test(plausibility.step(waiting))
    assert by_test(plausibility.step(waiting))["ready"] == TickResult("ready", True, "not_ready")


@pytest.mark.parametrize("rpm", [0.0, CONFIG.plausibility.engine_running_rpm - 1.0, math.nan])
def test_no_patience_is_lost_while_the_engine_stands(rpm: float) -> None:
    plausibility = subject()
    for _ in range(2000):
        assert "ready" not in by_test(plausibility.step(sample(Quality.INVALID, 0.0, rpm)))


@pytest.mark.parametrize("pause", [sample(Quality.GOOD), sample(Quality.INVALID, 0.0, 0.0)])
def test_readiness_or_a_stop_starts_the_patience_anew(pause: Sample) -> None:
    plausibility = subject()
    waiting = sample(Quality.INVALID, ready=0.0)
    for _ in range(600):
        plausibility.step(waiting)
    plausibility.step(pause)
    for _ in range(600):
        assert not fails(plausibility.step(waiting), "ready")
    assert fails(plausibility.step(waiting), "ready")


def test_without_a_ready_signal_a_sensor_that_says_invalid_is_not_ready() -> None:
    names = ("lambda_measured", "engine_speed_rpm")
    plausibility = subject(names)
    assert not fails(plausibility.step(sample(Quality.GOOD, names=names)), "ready")
    for _ in range(round(CONFIG.plausibility.first_move_s / PERIOD_S)):
        results = by_test(plausibility.step(sample(Quality.INVALID, names=names)))
        assert not any(result.failed for result in results.values())
    assert fails(plausibility.step(sample(Quality.INVALID, names=names)), "ready")


@pytest.mark.parametrize(("rise", "ready_from"), [(0.0, 90), (1.0, 75)])
def test_a_first_move_is_waited_for_over_blocks(rise: float, ready_from: int) -> None:
    # a reading that stands, and one that has moved far enough only with what came before its block
    readiness = Readiness(CONFIG.plausibility, ("lambda_measured",), 1.0)
    yes, step = np.ones(60, dtype=np.bool_), rise * CONFIG.plausibility.stuck_range / 74.5
    found = [readiness.push(1.0 + step * np.arange(at, at + 60), yes, yes) for at in (0, 60)]
    assert np.flatnonzero(np.concatenate(found)).tolist() == [*range(ready_from, 120)]


def test_an_electrical_fault_matures_within_three_seconds() -> None:
    failed, _ = ticks_to_mature(CONFIG.debounce, PERIOD_S)
    assert 1.0 <= failed * PERIOD_S <= 3.0


STUCK = round(CONFIG.plausibility.stuck_s / PERIOD_S)
RANGE = CONFIG.plausibility.stuck_range


class ActivityOneByOne(ActivityTest):
    def step(self, measured: float) -> tuple[bool, str] | None:
        found = self.push(np.array([measured]), np.array([True]))
        return (found[0][1].failed, found[0][1].fault) if found else None


def output(percentile_0_1: float = 0.5) -> Channel:
    """Return the model's output; the lowest that training saw is 0.5."""
    return Channel(NAMES[0], "-", 0.5, SATURATED, percentile_0_1, SATURATED)


def activity() -> ActivityOneByOne:
    return ActivityOneByOne(CONFIG.plausibility, output(), NAMES, PERIOD_S)


def live(n: int, seed: int = 0) -> list[float]:
    return list(1.0 + 0.004 * np.random.default_rng(seed).standard_normal(n))


@pytest.mark.parametrize(
    ("in_cut", "is_found"), [(1.15, True), (3.0, False), (math.nan, False)], ids=str
)
def test_a_fuel_cut_does_not_count_and_a_reading_that_moves_there_lives(
    in_cut: float, is_found: bool
) -> None:
    # GIVEN cuts of one second every six, for as long as two stretches
    active = np.tile(np.repeat([True, False], [50, 10]), 4)
    measured = np.where(active, 1.15, in_cut)
    # WHEN the reading is the same between the cuts
    found = activity().push(measured, active)
    # THEN it is frozen only if it was so in the cuts, too
    assert any(still.failed for _, still in found) is is_found


@pytest.mark.parametrize(
    ("reads", "fault"),
    [
        (1.15, "stuck_lean"),
        (0.85, "stuck_rich"),
        (1.0, "stuck_at_one"),
        (1.029, "stuck_at_one"),
        (1.031, "stuck_lean"),
        (0.971, "stuck_at_one"),
        (0.969, "stuck_rich"),
    ],
)
def test_a_frozen_signal_is_found_and_named_by_its_value(reads: float, fault: str) -> None:
    test = activity()
    results = [test.step(reads) for _ in range(STUCK)]
    assert results[:-1] == [None] * (STUCK - 1)
    assert results[-1] == (True, fault)


@given(st.integers(0, 3 * STUCK), st.sampled_from([0.8, 1.0, 1.3]))
def test_a_signal_that_freezes_at_any_time_is_found_before_two_stretches_are_over(
    moves: int, reads: float
) -> None:
    test = activity()
    for value in live(moves):
        result = test.step(value)
        assert result is None or not result[0]
    failed_after = next(
        i for i in range(1, 2 * STUCK) if (result := test.step(reads)) is not None and result[0]
    )
    assert failed_after < 2 * STUCK


@given(st.integers(0, 2**32 - 1))
def test_a_live_signal_passes_every_stretch(seed: int) -> None:
    test = activity()
    results = [test.step(value) for value in live(3 * STUCK, seed)]
    judged = [result for result in results if result is not None]
    assert [failed for failed, _ in judged] == [False] * 3


def test_two_quantisation_steps_are_no_life_and_three_are() -> None:
    step = RANGE / 2.0
    for steps, frozen in ((2, True), (3, False)):
        test = activity()
        values = [1.0 if i % 2 else 1.0 + steps * step * 0.9999 for i in range(STUCK)]
        assert [test.step(value) for value in values][-1] == (frozen, "stuck_at_one")


@pytest.mark.parametrize("reads", [SATURATED, 16.0])
def test_a_signal_at_the_trained_lean_end_is_saturated_and_not_judged(reads: float) -> None:
    test = activity()
    assert [test.step(reads) for _ in range(5 * STUCK)] == [None] * (5 * STUCK)
    # and just inside it is frozen
    inside = math.nextafter(SATURATED, 1.0)
    assert [test.step(inside) for _ in range(STUCK)][-1] == (True, "stuck_lean")


def rests(names: tuple[str, ...], reads: float, percentile_0_1: float = 0.5) -> bool:
    test = ActivityOneByOne(CONFIG.plausibility, output(percentile_0_1), names, PERIOD_S)
    for k in range(STUCK):  # it was alive before
        test.step(0.9 + 0.1 * (k % 2))
    return [test.step(reads) for _ in range(STUCK)][-1] is None


def test_a_cold_sensor_may_rest_where_training_saw_it_rest_if_nothing_tells_so() -> None:
    assert rests(("lambda_measured",), 0.5)
    assert not rests(("lambda_measured",), 0.51)
    assert not rests(("lambda_measured",), 0.5, percentile_0_1=0.6)  # training only passed there
    assert not rests(("lambda_measured", "engine_speed_rpm"), 0.5)
    assert not rests(("lambda_measured", "sensor_ready"), 0.5)


@pytest.mark.parametrize(
    ("names", "rpm", "runs"),
    [(NAMES, 0.0, False), (NAMES, 800.0, True), (NAMES, math.nan, False), (NAMES[:2], 0.0, True)],
)
def test_the_engine_runs_if_its_speed_says_so_or_nothing_does(
    names: tuple[str, ...], rpm: float, runs: bool
) -> None:
    one = sample(Quality.GOOD, rpm=rpm, names=names)
    assert np.all(subject(names).running(one.values[np.newaxis])) == runs


def test_an_ecu_that_was_never_heard_may_start_late_but_not_for_ever() -> None:
    plausibility = subject()
    absent = sample(Quality.STALE, math.nan, math.nan)
    patience = round(CONFIG.plausibility.start_patience_s / PERIOD_S)
    rows = np.tile(absent.values, (patience, 1)), np.tile(absent.quality, (patience, 1))
    assert plausibility.push(*rows) == []
    assert fails(plausibility.step(absent), "communication")


def test_an_interruption_begins_the_stretch_anew() -> None:
    test = activity()
    for _ in range(STUCK - 1):
        test.step(1.2)
    test.reset()
    assert [test.step(1.2) for _ in range(STUCK - 1)] == [None] * (STUCK - 1)
    assert test.step(1.2) == (True, "stuck_lean")


def test_a_row_of_alike_results_matures_once_and_another_result_begins_it_anew() -> None:
    failed, passed = (TickResult("range", each, "out_of_range") for each in (True, False))
    maturing = Maturing(3, 2)
    assert maturing.push([Results(0, 2, failed), Results(2, 3, passed)]) == []
    assert maturing.push([Results(0, 2, failed)]) == []
    assert maturing.push([Results(0, 1, failed), Results(1, 9, failed)]) == [(0, failed)]
    assert maturing.push([Results(0, 5, passed)]) == [(1, passed)]
    maturing.reset()
    assert maturing.push([Results(0, 1, passed)]) == []
    assert maturing.push([Results(4, 5, passed)]) == [(4, passed)]
