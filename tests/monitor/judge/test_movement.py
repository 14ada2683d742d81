"""A reading that does not move with the mixture, or holds now and then."""

from dataclasses import replace

import numpy as np
import pytest

from monitor import Verdict, replay
from monitor.base import config
from monitor.base.types import FloatArray
from monitor.judge.bias import Course
from monitor.judge.decision.window_facts import WindowFacts
from monitor.judge.limits import NO_LIMITS
from monitor.judge.response.movement import DEAD, HOLDS, MovementRule
from monitor.judge.window import Window
from monitor.pipeline.replay import Setup
from tests.helpers.drives.drive_tables import PERIOD_S, columns
from tests.helpers.models.windows import readings

NOISE, N = 0.006, 50
RNG = np.random.default_rng(11)


def rule(noise: float = NOISE) -> MovementRule:
    limits = replace(NO_LIMITS, noise=noise, noise_memory=0.5)
    return MovementRule(config.load(), limits, PERIOD_S)


def mixture(windows: int, std: float) -> FloatArray:
    """Return phi in windows, a modulation of two seconds with this standard deviation."""
    t = np.arange(windows * N) * PERIOD_S
    return (1.0 + 2**0.5 * std * np.sin(2 * np.pi * t / 2.0)).reshape(windows, N)


def noisy(phi: FloatArray) -> FloatArray:
    return phi + 0.002 * RNG.standard_normal(phi.shape)


def faults(measured: FloatArray, healthy: FloatArray, noise: float = NOISE) -> list[str | None]:
    none = np.zeros(len(measured), dtype=np.bool_)
    return [each.fault for each in rule(noise).judge(measured, healthy, none)]


@pytest.mark.parametrize("level", [0.93, 1.0, 1.07])
def test_noise_around_any_constant_is_a_dead_sensor(level: float) -> None:
    healthy = mixture(30, 0.02)
    found = faults(noisy(np.full_like(healthy, level)), healthy)
    assert found[-1] == DEAD
    assert found.index(DEAD) <= 5


def test_a_dead_sensor_may_have_more_noise_than_a_good_model_errs() -> None:
    # GIVEN a model that errs by 0.0026, and a dead sensor with noise of 0.003
    healthy = mixture(30, 0.018)
    dead = 1.0 + 0.003 * RNG.standard_normal(healthy.shape)
    # THEN it is found, and the weakest live sensor with that noise is not
    assert faults(dead, healthy, noise=0.0026)[-1] == DEAD
    weak = dead + 0.4 * (healthy - 1.0)
    assert not any(faults(weak, healthy, noise=0.0026))


@pytest.mark.parametrize(("share", "fault"), [(1.0, None), (0.5, DEAD)])
def test_a_reading_at_the_end_of_its_range_around_a_fuel_cut_is_in_air(
    setup: Setup, share: float, fault: str | None
) -> None:
    # GIVEN a reading that shows little of a mixture which turns from air to rich again and again
    card, own = setup.model.card, setup.config
    bank = readings(own.response, PERIOD_S, 0.5 + 0.4 * np.sin(np.arange(N // 2)))
    measured = share * card.output.maximum + 0.003 * (1.0 + np.sin(np.arange(N // 2)))
    window = Window(0, 0, 1, measured, 1.0 / bank[:, 0], bank, is_cut=True)
    facts = WindowFacts(setup.limits, own, card).of([window] * 20)
    # THEN it is dead, unless it stands where a healthy one reads air
    assert facts[-1].moved.fault == fault


@pytest.mark.parametrize("gain", [0.3, 0.5, 1.0, 1.4])
def test_a_weak_sensor_is_alive(gain: float) -> None:
    healthy = mixture(200, 0.02)
    assert not any(faults(noisy(1.0 + gain * (healthy - 1.0)), healthy))


def test_a_reading_that_moves_without_the_prediction_is_alive() -> None:
    healthy = mixture(200, 0.02)
    assert not any(faults(1.0 + 0.02 * RNG.standard_normal(healthy.shape), healthy))


def test_a_still_mixture_tells_nothing_of_a_still_reading() -> None:
    healthy = mixture(500, NOISE)  # moves by no more than the model errs
    assert not any(faults(noisy(np.ones_like(healthy)), healthy))


def test_a_sensor_that_dies_after_an_hour_of_driving_is_found_within_a_minute() -> None:
    healthy = mixture(740, 0.02)
    measured = noisy(healthy)
    measured[720:] = noisy(np.ones((20, N)))
    found = faults(measured, healthy)
    assert not any(found[:720])
    assert DEAD in found[720:732]


def held(phi: FloatArray, hold_s: float, every_s: float) -> FloatArray:
    """Return readings that hold for the first seconds of every so many."""
    flat = phi.ravel().copy()
    for k in range(1, len(flat)):
        if (k * PERIOD_S) % every_s < hold_s:
            flat[k] = flat[k - 1]
    return np.asarray(flat.reshape(phi.shape))


def test_holds_of_three_seconds_in_twelve_are_found_within_ninety_seconds() -> None:
    healthy = mixture(60, 0.02)
    found = faults(held(noisy(healthy), 3.0, 12.0), healthy)
    assert HOLDS in found[:24]


@pytest.mark.parametrize(("every", "fault"), [(2, HOLDS), (40, None)])
def test_holds_that_come_seldom_do_not_add_up_over_a_long_drive(
    every: int, fault: str | None
) -> None:
    healthy = mixture(800, 0.02)
    measured = noisy(healthy)
    measured[::every, 10:40] = measured[::every, 10:11]
    assert faults(measured, healthy)[-1] == fault


def test_a_sensor_that_lives_again_is_told_within_a_minute() -> None:
    healthy = mixture(140, 0.02)
    measured = noisy(healthy)
    measured[:120] = noisy(np.ones((120, N)))
    found = faults(measured, healthy)
    assert found[119] == DEAD
    assert not any(found[132:])


def test_a_coarse_logger_is_no_intermittent_sensor() -> None:
    healthy = mixture(300, 0.02)
    assert not any(faults(np.round(noisy(healthy) / 0.007) * 0.007, healthy))


def judged(
    change: FloatArray | None, *, without: tuple[str, ...] = (), **more: FloatArray
) -> Verdict:
    drive = columns() | more
    n = len(drive["lambda_measured"])
    if change is not None:
        drive["lambda_measured"] = np.where(
            np.isfinite(drive["lambda_measured"]), change, drive["lambda_measured"]
        )
    for name in without:
        del drive[name]
    return replay({"time_s": np.arange(n) * PERIOD_S, **drive})


def late(value: FloatArray | float, begin_s: float = 150.0) -> FloatArray:
    healthy = columns()["lambda_measured"]
    return np.where(np.arange(len(healthy)) * PERIOD_S < begin_s, healthy, value)


@pytest.mark.parametrize(("rail", "without"), [(15.9, ()), (1.9988, ("sensor_ready",))])
def test_a_sensor_pegged_at_its_lean_rail_is_found(rail: float, without: tuple[str, ...]) -> None:
    verdict = judged(late(rail), without=without)
    assert [code.fault for code in verdict.codes] == ["stuck_lean"]


def test_without_a_fuel_cut_signal_the_rail_is_a_fault_when_no_cut_lasts_so_long() -> None:
    pegged = late(15.9, 60.0)
    assert [c.fault for c in judged(pegged, without=("fuel_cut",)).codes] == ["stuck_lean"]
    assert not judged(late(15.9, 300.0), without=("fuel_cut",)).has_fault


@pytest.mark.parametrize("level", [0.95, 1.05])
def test_a_sensor_that_dies_with_noise_after_its_test_had_passed_is_found(level: float) -> None:
    n = len(columns()["lambda_measured"])
    verdict = judged(late(level + 0.003 * RNG.standard_normal(n)))
    assert [code.fault for code in verdict.codes] == ["no_activity"]


def test_a_drive_with_drops_to_one_value_is_intermittent() -> None:
    healthy = columns()["lambda_measured"]
    drops = np.where(np.arange(len(healthy)) % 97 < 6, 0.93, healthy)
    assert [code.fault for code in judged(drops).codes] == ["intermittent"]
    assert not judged(healthy).codes


def test_a_ramp_drifts_and_neither_a_step_nor_a_constant_does() -> None:
    noise = 0.0035 * RNG.standard_normal(400)
    ramp, step = np.linspace(0.0, 0.1, 400), np.repeat([0.0, 0.1], 200)
    for offsets, drifts in ((ramp, True), (step, False), (np.full(400, 0.1), False)):
        course = Course()
        for each in (offsets + noise).tolist():
            course.push(each)
        assert course.drifts(0.0035) is drifts


def test_a_sensor_that_never_moves_is_not_ready_where_no_signal_says_so() -> None:
    n = len(columns()["lambda_measured"])
    codes = judged(np.full(n, 0.997), without=("sensor_ready",)).codes
    assert [code.fault for code in codes] == ["not_ready"]
    # nor does a heater at full duty change that it never moved: then the heater is named
    heated = judged(
        np.full(n, 0.997), without=("sensor_ready",), sensor_heater_percent=np.full(n, 100.0)
    )
    assert [code.fault for code in heated.codes] == ["heater"]
