"""In what a reading without a chain differs from that of healthy runs."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np
import pytest

from monitor.base.types import FloatArray
from training.gap.response.difference import Difference, difference_of
from training.gap.response.equations import Held, two_sided
from training.gap.response.reference import ResponseReference
from training.greybox.fit.drive import Comparison
from training.greybox.quantity.dynamics import lag

PERIOD_S: Final = 0.5
INPUTS: Final = ("speed", "load")


def run(seed: int) -> Comparison:
    """A reading that follows speed and load, with slow noise of its own, 20 minutes."""
    rng = np.random.default_rng(seed)
    n = 2400
    speed, load = (lag(np.repeat(rng.normal(size=n // 20), 20), 2.0, PERIOD_S) for _ in INPUTS)
    reading = 1.0 + 0.1 * np.tanh(speed) + 0.05 * lag(load, 1.0, PERIOD_S)
    reading += 0.01 * lag(rng.normal(size=n), 1.0, PERIOD_S) + 0.002 * rng.normal()
    return Comparison(
        name=f"run {seed}",
        period_s=PERIOD_S,
        signals={"speed": speed, "load": load},
        phi_measured=reading,
        phi_predicted=np.zeros(n),
        scored=np.arange(n) >= 20,
    )


@cache
def healthy() -> ResponseReference:
    return ResponseReference.learn([run(seed) for seed in range(6)], INPUTS)


@cache
def new() -> tuple[Comparison, ...]:
    return tuple(run(seed) for seed in (11, 12, 13, 14, 15))


def found(read: Callable[[int, Comparison], FloatArray]) -> Difference:
    """Return in what the new runs differ when something else is read in each."""
    changed = [replace(r, phi_measured=read(i, r)) for i, r in enumerate(new())]
    return difference_of(changed, healthy())


def test_runs_as_they_were_have_no_gap() -> None:
    assert found(lambda _, r: r.phi_measured).best is None


def test_samples_a_minute_apart_are_compared_too() -> None:
    slow, known = ([replace(r, period_s=60.0) for r in each] for each in (new(), healthy().healthy))
    assert difference_of(slow, ResponseReference.learn(known, INPUTS)).best is None


def test_a_ripple_over_speed_is_described() -> None:
    answer = found(lambda _, r: r.phi_measured + 0.005 * np.sin(6.0 * r.signals["speed"]))
    assert answer.best is not None
    assert (answer.best.kind, answer.best.driver) == ("level", "speed")
    assert not answer.like_sensor
    assert "changes with the speed" in answer.best.sentence


def test_a_valve_that_rests_in_98_of_100_samples_is_described_by_where_it_opens() -> None:
    # GIVEN a valve that opens for some seconds, and a reading that follows it
    def valved(r: Comparison, size: float) -> Comparison:
        opening = np.zeros(len(r.phi_measured))
        for at in np.random.default_rng(len(r.name)).integers(50, len(opening) - 50, 4):
            opening[at : at + 9] = np.linspace(0.2, 1.0, 9)
        more = replace(r, signals={**r.signals, "valve": opening})
        return replace(more, phi_measured=r.phi_measured + size * opening)

    usual = ResponseReference.learn([valved(run(seed), 0.0) for seed in range(6)], INPUTS)
    answer = difference_of([valved(r, 0.1) for r in new()], usual)
    # THEN the curve goes from where it rests to where it is open
    assert answer.best is not None
    assert (answer.best.kind, answer.best.driver) == ("level", "valve")
    assert answer.curve is not None
    assert (answer.curve.x[0], answer.curve.x[-1]) == pytest.approx((0.0, 0.8), abs=0.3)


def test_a_gain_that_lowers_the_error_is_found() -> None:
    answer = found(lambda _, r: 1.0 + 0.7 * (r.phi_measured - 1.0))
    assert answer.like_sensor
    assert answer.response is not None
    assert answer.response.gain == pytest.approx(0.7, abs=0.05)
    assert next(f for f in answer.findings if f.kind == "swing").significant


def test_a_slow_reading_is_described_by_its_lag() -> None:
    answer = found(lambda _, r: lag(r.phi_measured, 2.0, PERIOD_S))
    assert answer.like_sensor
    assert answer.response is not None
    assert answer.response.lag_s + answer.response.delay_s == pytest.approx(2.0, abs=0.5)


def test_an_offset_that_begins_with_a_run_names_the_run() -> None:
    answer = found(lambda i, r: r.phi_measured + 0.03 * (i >= 3))
    assert answer.like_sensor
    assert answer.best is not None
    assert "From run 14 on the reading is +0.03" in answer.best.sentence


def asked(r: Comparison, more: float, off: float = 0.0) -> Comparison:
    """Return a run that tells its lambda target, ``more`` phi at high load, and reads it so."""
    richer = more * (r.signals["load"] > 0.0)
    target = 1.0 + 0.1 * np.tanh(r.signals["speed"]) + richer
    told = replace(r, signals={**r.signals, "lambda_target": 1.0 / target})
    return replace(told, phi_measured=r.phi_measured + lag(richer, 1.0, PERIOD_S) + off)


@cache
def usual() -> ResponseReference:
    return ResponseReference.learn([asked(run(seed), 0.0) for seed in range(6)], INPUTS)


def test_a_reading_that_goes_where_the_target_went_is_what_the_ecu_asks_for() -> None:
    answer = difference_of([asked(r, -0.05 * (i >= 2)) for i, r in enumerate(new())], usual())
    assert answer.best is not None
    assert answer.best.sentence.startswith("The ECU asks for it: ")
    assert not answer.like_sensor


def test_an_offset_beside_a_target_that_stays_is_the_sensors() -> None:
    assert difference_of([asked(r, 0.0, off=0.02) for r in new()], usual()).like_sensor


BLOCKS: Final = 40
NEW, HEALTHY = np.arange(5), np.arange(5, 12)


def held(slopes: FloatArray, power: FloatArray, seed: int = 0) -> Held:
    """Runs with these slopes and this power in each block; an error of 0.3 times its root."""
    rng = np.random.default_rng(seed)
    each = np.repeat(power, BLOCKS)
    noise = 0.3 * np.sqrt(each) * rng.standard_normal(len(each))
    run = np.repeat(np.arange(12), BLOCKS)
    return Held(np.repeat(slopes, BLOCKS) * each + noise, each, NEW, HEALTHY, run, np.ones(1))


def test_runs_that_show_an_effect_to_different_extent_agree_on_it() -> None:
    slopes = np.repeat([1.0, 0.0], [5, 7])
    alike = held(slopes, np.ones(12)).t
    unlike = held(slopes, np.tile([0.2, 3.0, 0.5, 1.0], 3)).t
    assert unlike > 0.7 * alike > 7.0


def test_a_run_that_does_not_show_the_effect_has_no_say() -> None:
    slopes, power = np.repeat([1.0, 0.0], [5, 7]), np.ones(12)
    without = held(slopes, np.where(np.arange(12) == 2, 1e-12, power))
    assert without.t > 7.0


def test_fits_to_each_other_of_runs_without_an_effect_are_rarely_beyond_chance() -> None:
    rng, wrong = np.random.default_rng(0), []
    for _ in range(400):
        own = rng.standard_normal((12, 3))  # every run differs in its own way, in three columns
        new = own[:5] - own[5:].mean(axis=0)
        fits = np.array([np.delete(new, i, axis=0).mean(axis=0) for i in range(5)])
        usual = np.array([np.delete(own[5:], i, axis=0).mean(axis=0) for i in range(7)])
        fits = np.concatenate([fits, np.tile(new.mean(axis=0), (7, 1))])
        own = np.concatenate([new, own[5:] - usual])
        cross, power = (own * fits).sum(axis=1), (fits**2).sum(axis=1)
        wrong.append(Held(cross, power, NEW, HEALTHY, np.arange(12), np.ones(3)).t)
    assert np.mean(np.array(wrong) > 2.764) < 0.02  # Student's t, 10 degrees: 0.01


def test_two_groups_alike_by_chance_are_as_unsure_as_their_blocks() -> None:
    t = two_sided(np.ones(5), np.full(5, 1.0), np.zeros(7), np.full(7, 1.0))
    assert np.isclose(t, 1.0 / np.sqrt(1 / 5 + 1 / 7))
