"""The response rule. The sensors that are judged here are not made by the bank's own equations.

The measured signal comes from continuous-time models at 100 Hz: a second-order sensor, dead times
that are no multiple of a sample, a sensor that holds before it follows, coloured noise,
quantisation; the prediction has a gain error and a wandering error of its own. Both are averaged
to 10 Hz, and only then does the rule see them.
"""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from monitor.base import config
from monitor.base.types import FloatArray
from monitor.judge.limits import NO_LIMITS, Limits
from monitor.judge.response.bank import DIRECTIONS, build
from monitor.judge.response.rule import Response, ResponseRule
from monitor.judge.trust import Trust
from monitor.memory.codes import CODES
from tests.helpers.drives.simulated_drives import to_grid
from tests.helpers.examples import inputs
from tests.helpers.models.windows import readings
from training.limits.response.response_limits import healthy_gain

STEP_S, PERIOD_S, WINDOW = 0.01, 0.1, 50
CONFIG = config.load().response
BANK = build(CONFIG)
Sensor = Callable[[FloatArray], FloatArray]


def poles(u: FloatArray, *taus_s: float) -> FloatArray:
    """First-order stages in a row, by the bilinear transform."""
    for tau_s in taus_s:
        b = STEP_S / (STEP_S + 2.0 * tau_s)
        a = (STEP_S - 2.0 * tau_s) / (STEP_S + 2.0 * tau_s)
        u = u[0] + np.asarray(lfilter([b, b], [1.0, a], u - u[0]))
    return u


def coloured(n: int, rng: np.random.Generator, std: float, tau_s: float) -> FloatArray:
    keep = math.exp(-STEP_S / tau_s)
    white = rng.standard_normal(n)
    return np.asarray(std * lfilter([math.sqrt(1.0 - keep**2)], [1.0, -keep], white))


def mixture_phi(n: int, rng: np.random.Generator) -> FloatArray:
    """Forced modulation with a wandering phase, and band-limited changes of load."""
    phase = rng.uniform(0.35, 0.6) * np.arange(n) * STEP_S
    phase += 0.04 * math.sqrt(STEP_S) * np.cumsum(rng.standard_normal(n))
    modulation = 0.025 * np.clip(2.5 * np.sin(2.0 * np.pi * phase), -1.0, 1.0)
    return np.asarray(1.0 + modulation + 0.012 * poles(coloured(n, rng, 1.0, 0.5), 0.15))


def slow(direction: str, tau_s: float) -> Sensor:
    """A lag on the edges of one direction, integrated by the midpoint method."""

    def read(u: FloatArray) -> FloatArray:
        x, out = u[0], np.empty_like(u)
        for k, v in enumerate(u):
            acts = direction == "symmetric" or (v > x) == (direction == "lean_to_rich")
            x = x + (v - x) * STEP_S / tau_s * (1.0 - STEP_S / tau_s / 2.0) if acts else v
            out[k] = x
        return out

    return read


def late(direction: str, delay_s: float) -> Sensor:
    """A dead time as defined, in continuous time: between two samples as well."""

    def read(u: FloatArray) -> FloatArray:
        t_s = np.arange(len(u)) * STEP_S
        then = np.interp(t_s - delay_s, t_s, u)
        if direction == "symmetric":
            return np.asarray(then)
        return np.asarray(
            np.minimum(u, then) if direction == "lean_to_rich" else np.maximum(u, then)
        )

    return read


def holding(direction: str, delay_s: float) -> Sensor:
    """Another mechanism: holds, and follows the edge only when it is so old."""

    def read(u: FloatArray) -> FloatArray:
        sign = 1.0 if direction == "lean_to_rich" else -1.0
        x, age_s, out = u[0], 0.0, np.empty_like(u)
        for k, v in enumerate(u):
            if sign * (v - x) > 0.001:
                age_s += STEP_S
                x += (v - x) * STEP_S / 0.03 if age_s >= delay_s else 0.0
            else:
                x, age_s = v, 0.0
            out[k] = x
        return out

    return read


def weak(gain: float) -> Sensor:
    return lambda u: 1.0 + gain * (u - 1.0)


def healthy(u: FloatArray) -> FloatArray:
    return u


def drive(sensor: Sensor, seed: int, duration_s: float = 200.0) -> tuple[FloatArray, FloatArray]:
    """Measured and predicted phi at 10 Hz, each (n,)."""
    rng = np.random.default_rng(seed)
    n = round(duration_s / STEP_S)
    phi = mixture_phi(n, rng)
    predicted = 1.0 + (poles(phi, 0.10, 0.05) - 1.0) * rng.uniform(0.95, 1.05)
    predicted += coloured(n, rng, 0.003, 2.0)
    read = poles(sensor(poles(phi, 0.09, 0.03)), 0.02, 0.01)
    measured = 1.0 / (np.rint(1.0 / read / 0.0005) * 0.0005) + coloured(n, rng, 0.004, 0.15)
    return to_grid(measured), to_grid(predicted)


@cache
def errors() -> Limits:
    """How the model errs on a healthy drive, as it is taken for the card."""
    measured, predicted = drive(healthy, 1000)
    windows = (measured - predicted).reshape(-1, WINDOW)
    windows -= windows.mean(axis=1, keepdims=True)
    memory = (windows[:, 1:] * windows[:, :-1]).sum() / (windows**2).sum()
    plain = replace(NO_LIMITS, noise=float(windows.std()), noise_memory=float(memory))
    moments = ResponseRule(CONFIG, plain, PERIOD_S).regressed(*cut(measured, predicted))
    gain = healthy_gain([moments], plain, CONFIG.noise_least)
    return replace(plain, gain_model=gain, evidence=0.75, evidence_gain=4.0)


def new_rule(untested: Sequence[str] = (), **own: float) -> ResponseRule:
    limits = replace(errors(), trust=Trust(1, dict.fromkeys(untested, 0)), **own)
    return ResponseRule(CONFIG, limits, PERIOD_S)


def cut(measured: FloatArray, predicted: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
    rows = readings(CONFIG, PERIOD_S, predicted)
    starts = range(0, len(measured) - WINDOW + 1, WINDOW)
    windows = np.array([measured[i : i + WINDOW] for i in starts])
    return windows, [rows[i : i + WINDOW] for i in starts]


def judge(measured: FloatArray, predicted: FloatArray, rule: ResponseRule) -> list[Response]:
    windows, banks = cut(measured, predicted)
    return rule.judge(windows, banks, np.zeros(len(windows), dtype=np.bool_))


def verdicts(sensor: Sensor, seed: int) -> list[Response]:
    return judge(*drive(sensor, seed), new_rule())


@pytest.mark.parametrize(
    ("sensor", "seed", "most"),
    [
        *(pytest.param(healthy, seed, 0.8, id=f"healthy {seed}") for seed in range(6)),
        pytest.param(slow("symmetric", 0.12), 3, 0.5, id="slow"),
        pytest.param(late("symmetric", 0.12), 3, 0.5, id="late"),
        pytest.param(late("lean_to_rich", 0.12), 3, 0.5, id="late on one edge"),
        pytest.param(weak(0.88), 3, 0.5, id="weak"),
    ],
)
def test_a_sensor_within_its_limits_passes(sensor: Sensor, seed: int, most: float) -> None:
    outcomes = Counter(v.outcome for v in verdicts(sensor, seed))
    assert outcomes["failed"] == 0
    assert outcomes["passed"] > most * outcomes.total()


def failed_only(found: list[Response]) -> list[Response]:
    """The verdicts of a faulty sensor: none passed, and most failed."""
    failed = [v for v in found if v.outcome == "failed"]
    assert "passed" not in {v.outcome for v in found}
    assert len(failed) >= len(found) // 2
    return failed


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("seconds", [0.54, 1.13])
@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("kind", ["slow", "delay"])
def test_a_slow_or_late_sensor_is_found_and_named_by_its_edge(
    kind: str, direction: str, seconds: float, seed: int
) -> None:
    name = f"{kind}_{direction}"
    found = verdicts((slow if kind == "slow" else late)(direction, seconds), seed)
    failed = failed_only(found)
    # the code is right in every window; a lag between two of the bank's may read as slow and weak
    assert {CODES[v.fault] for v in failed if v.fault} == {CODES[name]}
    assert Counter(v.fault for v in failed).most_common(1)[0][0] == name
    if direction != "symmetric" or kind == "delay":
        assert {v.fault for v in failed} == {name}
    for edge in ("rich_to_lean", "lean_to_rich"):
        what = f"{'lag' if kind == 'slow' else 'dead_time'}_{edge}"
        estimate, std = (
            getattr(found[-1].statistics, f"{what}{unit}") for unit in ("_s", "_std_s")
        )
        assert 0.0 <= std < 0.5 * seconds
        if direction in (edge, "symmetric"):
            assert 0.6 * seconds < estimate < 1.6 * seconds
        else:
            assert estimate < 0.1


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("direction", ["rich_to_lean", "lean_to_rich"])
def test_a_sensor_that_holds_before_an_edge_is_late_on_it(direction: str, seed: int) -> None:
    failed = failed_only(verdicts(holding(direction, 0.55), seed))
    assert {v.fault for v in failed} == {f"delay_{direction}"}
    # held for half a period of the modulation the signal hardly comes through: the edge is right,
    # but for some windows it looks weak
    names = Counter(v.fault for v in failed_only(verdicts(holding(direction, 1.1), seed)))
    assert names.keys() <= {f"delay_{direction}", f"slow_{direction}", "gain_low"}
    assert names["gain_low"] < 0.2 * names.total()


@pytest.mark.parametrize("seed", range(2))
def test_a_sensor_that_is_slow_in_two_stages_is_found_on_both_edges(seed: int) -> None:
    # two stages have the phase of a dead time, so either name may come
    failed = failed_only(verdicts(lambda u: poles(u, 0.6, 0.2), seed))
    assert {v.fault for v in failed} <= {"slow_symmetric", "delay_symmetric"}


@pytest.mark.parametrize("seed", range(2))
def test_a_weak_sensor_is_found_and_named_and_its_gain_is_estimated(seed: int) -> None:
    found = verdicts(weak(0.5), seed)
    assert {v.fault for v in failed_only(found)} == {"gain_low"}
    gain, spread = found[-1].statistics.gain, found[-1].statistics.gain_std
    assert gain == pytest.approx(0.5, abs=0.05)
    assert 0.0 < spread < 0.05


@pytest.mark.parametrize("seed", range(2))
def test_a_slow_and_weak_sensor_has_the_code_of_the_transient_fault(seed: int) -> None:
    failed = failed_only(verdicts(lambda u: weak(0.7)(slow("symmetric", 0.6)(u)), seed))
    assert {CODES[v.fault] for v in failed if v.fault} == {CODES["transient"]}
    assert all("transient" in (v.fault, *v.also) for v in failed[-5:])


def test_a_mixture_that_hardly_moves_decides_nothing() -> None:
    # GIVEN a sensor that is far too slow, and a mixture that moves by a tenth of its noise
    measured, predicted = drive(slow("symmetric", 2.0), 1)
    rng = np.random.default_rng(2)
    still = 1.0 + (predicted - 1.0) * 0.01
    read = 1.0 + (measured - 1.0) * 0.01 + rng.normal(0.0, errors().noise, len(measured))
    found = judge(read, still, new_rule())
    assert {v.outcome for v in found} == {"inconclusive"}


def test_windows_that_say_little_decide_together() -> None:
    # GIVEN a late sensor under a mixture so still that no window decides by itself
    measured, predicted = drive(late("symmetric", 0.6), 1, 1000.0)
    rng = np.random.default_rng(2)
    read = measured + rng.normal(0.0, 0.06, len(measured))
    rule = new_rule(noise=math.hypot(0.06, errors().noise), noise_memory=0.0)
    found = judge(read, predicted, rule)
    assert {v.outcome for v in found[:2]} == {"inconclusive"}
    assert found[-1].fault == "delay_symmetric"


def test_a_small_step_that_fits_a_weak_sensor_by_chance_says_little() -> None:
    # GIVEN one step of the mixture, half as high in the reading
    predicted = 1.0 + 0.01 * (np.arange(WINDOW) >= WINDOW // 2)
    measured = 1.0 + 0.5 * (predicted - 1.0)

    def evidence(noise_std: float) -> float:
        own = replace(NO_LIMITS, noise=noise_std, evidence=1.0, evidence_gain=10.0)
        rule = ResponseRule(CONFIG, own, PERIOD_S)
        return judge(measured, predicted, rule)[-1].statistics.evidence

    # THEN a model that errs by less is believed, and one that errs by more is not
    assert evidence(0.001) == pytest.approx(CONFIG.evidence_window)
    assert evidence(0.02) < 1.0


def test_an_ignored_window_leaves_no_evidence() -> None:
    measured, predicted = drive(late("symmetric", 0.6), 1, 40.0)
    rule, other = new_rule(), new_rule()
    judge(measured, predicted, rule)
    before = judge(measured, predicted, other)[-1].statistics.evidence
    rows = np.ones((WINDOW, len(BANK))) * predicted[:WINDOW, None]
    (ignored,) = rule.judge(measured[np.newaxis, :WINDOW], [rows], np.array([True]))
    assert ignored.outcome == "inconclusive"
    assert ignored.statistics.evidence == before
    assert before != 0.0


@inputs(20)
@given(st.floats(-0.1, 0.1), st.integers(0, 3))
def test_an_offset_of_the_measurement_does_not_change_the_verdict(offset: float, seed: int) -> None:
    measured, predicted = drive(late("rich_to_lean", 0.5), seed, 20.0)
    plain = judge(measured, predicted, new_rule())
    moved = judge(measured + offset, predicted, new_rule())
    assert [(v.outcome, v.fault, v.also) for v in plain] == [
        (v.outcome, v.fault, v.also) for v in moved
    ]


def test_after_a_repair_the_sensor_passes_within_a_driving_cycle() -> None:
    rule = new_rule()
    before = judge(*drive(late("symmetric", 0.6), 7), rule)
    assert before[-1].outcome == "failed"
    # WHEN it is repaired and the drive goes on
    after = judge(*drive(healthy, 8), rule)
    # THEN it passes from 25 windows on, about two minutes, with a doubt at most, and fails no more
    outcomes = Counter(v.outcome for v in after[25:])
    assert outcomes["failed"] == 0
    assert outcomes["passed"] > 0.9 * outcomes.total()


def test_after_a_long_healthy_time_a_fault_is_found_nearly_as_soon_as_from_the_start() -> None:
    rule = new_rule()
    judge(*drive(healthy, 9, 1000.0), rule)
    after = judge(*drive(slow("symmetric", 1.0), 10), rule)
    # within 45 s, with its code within a minute
    assert {v.outcome for v in after[9:]} == {"failed"}
    assert {CODES[v.fault or ""] for v in after[12:]} == {CODES["slow_symmetric"]}


def test_one_window_says_no_more_than_half_of_what_decides() -> None:
    # GIVEN a window of a healthy drive, with one step that the model predicts a second early
    measured, predicted = (x[:WINDOW] for x in drive(healthy, 21, 60.0))
    step, early = np.zeros((2, WINDOW))
    step[25:] = early[15:] = 0.3
    (found,) = judge(measured + step, predicted + early, new_rule())
    # THEN it speaks for a late sensor by so much, and no more
    assert found.statistics.hypothesis.startswith("delay")
    assert found.statistics.evidence == pytest.approx(CONFIG.evidence_window)


def test_a_fault_that_the_model_cannot_find_keeps_no_other_test_from_its_verdict() -> None:
    # GIVEN a model on whose amplitudes nothing can be built
    rule, resigned = (new_rule(own, evidence_gain=0.01) for own in ((), ("gain_low",)))
    # WHEN a sensor between sound and weak is judged
    measured, predicted = drive(weak(0.68), 13)
    # THEN it is called sound only where the model is known to find no weak one
    assert {v.outcome for v in judge(measured, predicted, rule)} == {"inconclusive"}
    assert judge(measured, predicted, resigned)[-1].outcome == "passed"
    # and a weak sensor that shows clearly has its code all the same
    assert judge(*drive(weak(0.4), 13), new_rule(untested=["gain_low"]))[-1].fault == "gain_low"


def test_no_sensor_is_called_sound_that_is_near_its_limit() -> None:
    # GIVEN a sensor late by 0.2 s, and a punctual one
    near, punctual = drive(late("symmetric", 0.2), 5), drive(healthy, 5)
    # THEN the late one is neither faulty nor sound, for the prediction may be late itself
    rule = new_rule()
    assert {v.outcome for v in judge(*near, rule)} == {"inconclusive"}
    # and the evidence that is missing is that against this dead time
    assert max(rule.odds.values()) == rule.odds["delay_symmetric"] > -CONFIG.evidence_pass
    # THEN the punctual one passes
    assert judge(*punctual, rule := new_rule())[-1].outcome == "passed"
    assert max(rule.odds.values()) <= -CONFIG.evidence_pass


def test_a_manoeuvre_on_which_the_model_errs_turns_no_decision_over() -> None:
    # GIVEN a sound sensor, and a model that is right but for one manoeuvre of two windows, in which
    # it moves twice as much as the mixture
    measured, predicted = drive(healthy, 21)
    wrong = slice(20 * WINDOW, 22 * WINDOW)
    predicted[wrong] = 1.0 + 2.0 * (predicted[wrong] - 1.0)
    # THEN no window fails, and the sensor passes again soon
    found = judge(measured, predicted, new_rule())
    assert "failed" not in {v.outcome for v in found}
    assert {v.outcome for v in found[26:]} == {"passed"}


def test_a_vehicle_of_little_gain_is_judged_against_its_own_gain() -> None:
    # GIVEN a vehicle whose healthy sensor follows with 0.86 of the model's amplitude
    # WHEN its sensor weakens to 0.85 of that, which is within specification
    found = judge(*drive(weak(0.86 * 0.85), 13), new_rule(gain=0.86))
    # THEN it is not called weak, and at half of it it is
    assert "failed" not in {v.outcome for v in found}
    found = judge(*drive(weak(0.86 * 0.55), 13), new_rule(gain=0.86))
    assert {v.fault for v in found[6:]} == {"gain_low"}


def test_the_other_names_of_an_undecided_fault_are_other_names() -> None:
    names = {h.fault for h in BANK if h.beyond_limit} | {"transient", "gain_low"}
    undecided = 0
    for seed in range(4):
        for v in verdicts(lambda u: poles(u, 0.45, 0.35), seed):
            assert v.fault is None or v.fault in names
            assert v.fault not in v.also
            assert set(v.also) <= names
            undecided += bool(v.also)
    assert undecided  # two equal stages lie between a lag and a dead time
