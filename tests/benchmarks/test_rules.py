"""Rules from the literature, on simulated drives with the fault in the control loop."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from benchmarks.studies.rules.adaptive import AdaptiveThreshold
from benchmarks.studies.rules.alarms import RULES, Alarms
from benchmarks.studies.rules.differences import DifferencesRule
from benchmarks.studies.rules.fuzzy import FuzzyRule
from benchmarks.studies.rules.paper import PaperRule
from benchmarks.studies.rules.windows import Rule, Windows, limit_for
from monitor.base import config, faults
from monitor.base.errors import RecordingError
from monitor.judge.limits import NO_LIMITS
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.drives.recordings import recording_of_samples
from tests.helpers.drives.simulated_drives import WARM, sampled
from training.dyno.simulation import Experiment
from training.limits.judging import judge_recordings

RATE = 0.05
HEALTHY = Experiment(cycle="hwfet", conditions=WARM)


def windows(*experiments: Experiment) -> Windows:
    model, settings = Model.load(shipped_model()), config.load()
    drives = [recording_of_samples(*sampled(each)) for each in experiments]
    return Windows.of([d.windows for d in judge_recordings(drives, model, NO_LIMITS, settings)])


@pytest.fixture(scope="module")
def healthy() -> Windows:
    return windows(*(replace(HEALTHY, seed=seed) for seed in (9001, 9002, 9003)))


@pytest.fixture(scope="module")
def others() -> Windows:
    return windows(*(replace(HEALTHY, seed=seed) for seed in (9004, 9005, 9006)))


@pytest.fixture(scope="module")
def faulty() -> dict[str, Windows]:
    severities = {"slow_symmetric": 0.6, "delay_lean_to_rich": 0.5, "gain_low": 0.6}
    return {
        name: windows(replace(HEALTHY, seed=9007, fault=faults.resolve(name, severity)))
        for name, severity in severities.items()
    }


def together(parts: dict[str, Windows]) -> Windows:
    each = list(parts.values())
    return Windows(np.vstack([w.measured for w in each]), np.vstack([w.predicted for w in each]))


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_the_false_alarm_rate_holds_on_drives_that_set_no_limit(
    rule: type[Rule], healthy: Windows, others: Windows, faulty: dict[str, Windows]
) -> None:
    # GIVEN a rule set on three healthy drives
    fitted = rule.fit(healthy, together(faulty), RATE)
    # WHEN it judges three other drives
    alarms = int(fitted.faulty(others).sum())
    # THEN no more windows alarm than chance allows, the limit's own included
    n, m = len(others), len(healthy)
    most = stats.betabinom.ppf(0.999, n, RATE * (m + 1), (1.0 - RATE) * (m + 1))
    assert n > 100
    assert alarms <= most
    assert fitted.faulty(healthy).mean() <= RATE


@pytest.mark.parametrize(
    ("rule", "fault", "least"),
    [
        (PaperRule, "slow_symmetric", 0.9),
        (PaperRule, "delay_lean_to_rich", 0.9),
        (FuzzyRule, "slow_symmetric", 0.9),
        (FuzzyRule, "delay_lean_to_rich", 0.9),
        (FuzzyRule, "gain_low", 0.8),
        (DifferencesRule, "slow_symmetric", 0.5),
        (AdaptiveThreshold, "slow_symmetric", 0.9),
        (AdaptiveThreshold, "delay_lean_to_rich", 0.9),
    ],
)
def test_a_faulty_sensor_in_the_loop_is_found(
    rule: type[Rule], fault: str, least: float, healthy: Windows, faulty: dict[str, Windows]
) -> None:
    # the limit faults that the rule learns are other windows than those it judges
    every = together(faulty)
    even = np.arange(len(every)) % 2 == 0
    learned = Windows(every.measured[even], every.predicted[even])
    fitted = rule.fit(healthy, learned, RATE)
    odd = np.arange(len(faulty[fault])) % 2 == 1
    own = faulty[fault]
    judged = Windows(own.measured[odd], own.predicted[odd])
    assert fitted.faulty(judged).mean() >= least


def test_too_few_windows_are_refused(healthy: Windows, faulty: dict[str, Windows]) -> None:
    few = Windows(healthy.measured[:18], healthy.predicted[:18])
    with pytest.raises(RecordingError, match="18 healthy windows, 19 are wanted"):
        PaperRule.fit(few, together(faulty), RATE)


def test_a_drive_alarms_by_two_windows_in_a_row() -> None:
    assert Alarms.of(np.array([True, False, True, True, False])) == Alarms(3, 3)
    assert Alarms.of(np.array([True, False, True])) == Alarms(2, None)
    assert Alarms.of(np.array([True])) == Alarms(1, None)


def test_the_limit_keeps_the_rate_for_any_distribution() -> None:
    # mean over many calibrations of the probability beyond the limit, skewed scores
    rng = np.random.default_rng(437)
    limits = [limit_for(rng.lognormal(0.0, 2.0, 437), RATE) for _ in range(400)]
    beyond = stats.lognorm.sf(limits, 2.0)
    assert beyond.mean() <= RATE + 3.0 * beyond.std() / 20.0
    assert beyond.mean() > 0.6 * RATE
