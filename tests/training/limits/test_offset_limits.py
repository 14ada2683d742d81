"""Limits of offsets and evidence: what a decision counts is what healthy drives are measured by."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base import config
from monitor.base.types import FloatArray
from monitor.judge.bias import BiasRule
from monitor.judge.findings import WindowJudged
from monitor.judge.limits import NO_LIMITS, Limits
from monitor.model.card import Limit
from monitor.model.step import Model
from monitor.pipeline.replay import set_up, shipped_model
from tests.helpers.models.windows import judged_window
from training.limits.decision_limits import healthy_offsets, limits_of
from training.limits.judging import judge_recordings
from training.limits.response import response_limits as rules
from training.recordings.recording import Recording, load

CONFIG = config.load()
BIAS = CONFIG.bias
CARD = Model.load(shipped_model()).card
FAR = 30.0  # standard deviations of an ordinary window, in a manoeuvre


def drives_of(manoeuvres: int, windows: int = 100) -> list[FloatArray]:
    """Return window means of two drives; the first one has windows that are far off."""
    first, second = np.random.default_rng(5).normal(0.0, 1.0, (2, windows))
    first[10 : 10 + manoeuvres] = FAR
    return [first, second]


def fails(limit: float, means: FloatArray) -> bool:
    rule = BiasRule(BIAS, Limits(offset_low=-limit, offset_high=limit, offset_std=limit / 6.0))
    return any(rule.judge(mean).outcome == "failed" for mean in means)


def test_a_manoeuvre_in_which_the_model_errs_by_far_does_not_widen_the_limit() -> None:
    _, ordinary = healthy_offsets(drives_of(0), BIAS)
    offsets, std = healthy_offsets(drives_of(2), BIAS)
    assert std < 1.3 * ordinary
    assert abs(offsets[0]) < 0.3 < np.mean(drives_of(2)[0])


def test_a_model_that_often_errs_by_far_keeps_all_of_its_spread() -> None:
    drives = drives_of(20)
    _, std = healthy_offsets(drives, BIAS)
    assert std == pytest.approx(np.sqrt(np.mean([drive.var() for drive in drives])))


def test_healthy_drives_pass_and_a_faulty_one_fails_that_the_plain_spread_would_hide() -> None:
    # GIVEN limits of healthy drives with a manoeuvre, and those by the plain spread
    drives = drives_of(2)
    bounded = 6.0 * healthy_offsets(drives, BIAS)[1]
    plain = 6.0 * np.sqrt(np.mean([drive.var() for drive in drives]))
    for limit, finds in ((bounded, True), (plain, False)):
        # THEN they have no code, and an offset has one only by the bounded spread
        assert not any(fails(limit, drive) for drive in drives)
        assert fails(limit, drives[-1] + 1.6 * bounded) is finds


@given(
    st.lists(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=50), min_size=1, max_size=4),
    st.floats(0.1, 10.0),
)
def test_the_spread_is_at_most_that_of_the_widest_drive_in_any_unit(
    drives: list[list[float]], unit: float
) -> None:
    means = [np.array(drive) for drive in drives]
    _, std = healthy_offsets(means, BIAS)
    assert std <= max(drive.std() for drive in means) * (1.0 + 1e-9)
    _, scaled = healthy_offsets([unit * drive for drive in means], BIAS)
    assert scaled == pytest.approx(unit * std, rel=1e-5, abs=1e-9)


def test_a_drive_unlike_all_others_widens_neither_the_limit_of_an_offset_nor_the_noise() -> None:
    # GIVEN five healthy drives, and the model ten times as wrong in one of them
    means = np.random.default_rng(3).normal(0.0, 0.02, (5, 60)).tolist()
    drives = [[judged(mean, swing=0.05) for mean in drive] for drive in means]
    unlike = [judged(10.0 * mean, swing=0.5) for mean in means[4]]
    # WHEN limits are set
    alike, found = (
        limits_of(each, CARD, CONFIG, "test", []) for each in (drives, [*drives[:4], unlike])
    )
    # THEN they are those of the others
    for name in ("offset_std", "noise"):
        assert found[name].value < 1.3 * alike[name].value, name


def judged(mean: float, swing: float) -> WindowJudged:
    """Return a window whose reading is off by ``mean`` and moves by ``swing``."""
    moves = swing * np.sin(np.arange(CONFIG.window.n_samples))
    return judged_window(mean, 0.01, measured=1.0 + mean + moves)


@pytest.mark.parametrize(("moving", "counts"), [(30, "moving"), (5, "all")])
def test_a_reading_that_stands_still_counts_no_more_than_in_a_decision(
    moving: int, counts: str
) -> None:
    # GIVEN windows in which the reading moves, and as many again in which it stands without error
    means = np.random.default_rng(2).normal(0.0, 0.02, moving)
    alive = [judged(float(mean), swing=0.05) for mean in means]
    still = [judged(0.0, swing=0.0)] * (2 * moving)
    # WHEN limits are set
    found = limits_of([[*alive, *still]], CARD, CONFIG, "test", [])["offset_std"].value
    # THEN only the first count, unless they are too few
    counted = means if counts == "moving" else np.array([*means, *np.zeros(2 * moving)])
    assert found == pytest.approx(counted.std(), rel=1e-6)


LOG = "replay_logs/healthy_micro_trips_v102_s102.blf"
LIMITS: Limits = set_up(None, (), CONFIG).limits
MODEL = Model.load(shipped_model())


def evidence_limits(drives: list[Recording], own: Limits = LIMITS) -> dict[str, Limit]:
    judged = judge_recordings(drives, MODEL, NO_LIMITS, CONFIG)
    return rules.response_limits(judged, MODEL.card, own, CONFIG)


def test_a_bet_on_a_fault_does_not_win_on_healthy_drives() -> None:
    # GIVEN what windows say for a fault in drives of three lengths, now and then much
    rng = np.random.default_rng(7)
    drives = [rng.standard_t(3, n) - 1.0 for n in (20, 200, 2000)]
    most = CONFIG.response.evidence_window
    # WHEN the weight is set
    weight = rules.weight_of(drives, most)
    # THEN a stake that grows by each window's weighted odds is as large as before on average
    assert weight > 0.0
    assert np.exp(weight * np.concatenate([[most], *drives])).mean() == pytest.approx(1.0)
    # and few windows allow less than many, for a window may be imagined that speaks for a fault
    assert rules.weight_of(drives[:1], most) < weight
    # THEN drives that speak for a fault on average leave no weight
    assert rules.weight_of([-each for each in drives], most) == rules.LEAST_EVIDENCE


def test_drives_that_the_model_follows_badly_lower_the_weight() -> None:
    # GIVEN a healthy drive that the model follows well, and one with an injector that nobody knows
    drive = load(LOG, period_s=0.1)
    values = drive.values.copy()
    fuel = values[:, drive.names.index("fuel_mass_mg")]
    fuel *= 1.0 + 0.2 * np.sin(np.arange(len(fuel)) / 10.0)
    strange = replace(drive, values=values)
    # WHEN limits are set by the first alone, and by both
    followed = evidence_limits([drive])
    both = evidence_limits([drive, strange])
    # THEN evidence counts for less
    assert both["evidence"].value < followed["evidence"].value


def test_drives_without_windows_say_nothing_of_gains_and_evidence() -> None:
    # GIVEN a drive, and three that are over before the engine is warm
    drive = load(LOG, period_s=0.1)
    short = drive.part(0, 100)
    # WHEN the limits are set THEN they are those of the drive alone
    assert evidence_limits([drive, short, short, short]) == evidence_limits([drive])


def test_an_earlier_calibration_does_not_change_the_next_one() -> None:
    # GIVEN a card that an earlier calibration gave little weight
    drive = load(LOG, period_s=0.1)
    earlier = replace(LIMITS, evidence=0.1)
    # WHEN its limits are set anew THEN they are those of a card without any
    assert evidence_limits([drive] * 2, earlier) == evidence_limits([drive] * 2)
