"""The healthy limit of an offset: what a decision counts is what healthy drives are measured by."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base import config
from monitor.base.types import FloatArray
from monitor.judge.bias import BiasRule
from monitor.judge.findings import WindowJudged
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.models.windows import judged_window
from training.limits.decision_limits import healthy_offsets, limits_of

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
    rule = BiasRule(BIAS, -limit, limit, limit / 6.0)
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
