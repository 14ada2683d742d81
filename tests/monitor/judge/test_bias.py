"""The paper's rule and the bias rule."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from monitor.base import config
from monitor.judge.bias import BiasRule, paper_failed
from monitor.judge.limits import NO_LIMITS


@given(st.floats(-2.0, 2.0), st.floats(0.0, 2.0), st.floats(1e-3, 1.0), st.floats(1e-3, 1.0))
@example(0.05, 0.25, 0.05, 0.25)
@example(-0.05, 0.25, 0.05, 0.25)
@example(math.nextafter(0.05, 0.0), 0.25, 0.05, 0.25)
@example(math.nextafter(-0.05, 0.0), 0.25, 0.05, 0.25)
@example(0.05, math.nextafter(0.25, 0.0), 0.05, 0.25)
def test_the_papers_rule_needs_mean_and_spread_at_their_limits_or_beyond(
    mean: float, std: float, j_mu: float, j_sigma: float
) -> None:
    assert paper_failed(mean, std, j_mu, j_sigma) == (
        (mean >= j_mu or -mean >= j_mu) and std >= j_sigma
    )


LIMIT = 0.065
BIAS = config.load().bias
STD = BIAS.window_std_lambda
OWN = replace(NO_LIMITS, offset_low=-LIMIT, offset_high=LIMIT, offset_std=STD)
MOST = LIMIT + BIAS.certainty * STD  # for which a window counts at most


def new_rule(low: float = -LIMIT, high: float = LIMIT) -> BiasRule:
    return BiasRule(BIAS, replace(OWN, offset_low=low, offset_high=high))


@given(st.lists(st.floats(-MOST, MOST), min_size=1, max_size=40))
@example([LIMIT + 0.01] * 6)  # too small for so few windows
def test_the_bias_rule_judges_the_fading_mean(means: list[float]) -> None:
    rule = new_rule()
    for i, mean in enumerate(means, start=1):
        got = rule.judge(mean)
        weights = BIAS.memory ** np.arange(i)[::-1]
        offset = float(np.average(means[:i], weights=weights))
        effective = weights.sum() ** 2 / (weights**2).sum()
        shared = BIAS.variance_shared
        std = STD * math.sqrt(shared + (1.0 - shared) / effective)
        assert got.offset == pytest.approx(offset, abs=1e-12)
        assert got.offset_std == pytest.approx(std, rel=1e-9)
        if i < BIAS.n_windows:
            assert (got.outcome, got.fault) == ("inconclusive", None)
        elif got.outcome == "failed":
            assert abs(offset) >= LIMIT + 0.999 * BIAS.certainty * std
            assert got.fault == ("biased_lean" if offset > 0.0 else "biased_rich")
        elif got.outcome == "passed":
            assert abs(offset) < LIMIT
        else:
            assert LIMIT <= abs(offset) <= LIMIT + 1.001 * BIAS.certainty * std


def test_the_limits_of_a_vehicle_need_not_be_alike() -> None:
    for offset, fault in ((0.06, None), (-0.04, "biased_rich"), (0.1, "biased_lean")):
        rule = new_rule(-0.01, 0.07)
        assert [rule.judge(offset) for _ in range(10)][-1].fault == fault


@pytest.mark.parametrize("step_most", [math.inf, BIAS.fuel_span_lambda])
def test_a_manoeuvre_in_which_the_model_errs_by_far_is_no_bias(step_most: float) -> None:
    # GIVEN a short drive, in which the model errs by far in two windows
    rule = BiasRule(BIAS, OWN, step_most)
    found = [rule.judge(mean) for mean in 5 * [0.0] + [2.0, 1.0] + 5 * [0.0]]
    # THEN neither fails, though the mean, which is told, is far off
    assert "failed" not in {each.outcome for each in found}
    assert max(each.offset for each in found) > 0.4


def test_an_ignored_window_is_no_bias() -> None:
    rule = new_rule()
    for _ in range(5):
        assert rule.judge(1.0, ignore=True).outcome == "inconclusive"
    assert [rule.judge(0.0).outcome for _ in range(3)] == ["inconclusive"] * 2 + ["passed"]


@pytest.mark.parametrize(("size", "fault"), [(0.1, "biased_lean"), (-0.1, "biased_rich")])
def test_an_offset_that_begins_late_in_a_drive_fails_within_a_few_windows(
    size: float, fault: str
) -> None:
    # GIVEN a healthy drive of 150 windows, whose mean fades slowly
    rule = BiasRule(BIAS, OWN, BIAS.fuel_span_lambda)
    noise = np.random.default_rng(3).normal(0.0, STD, 160)
    assert {rule.judge(mean).outcome for mean in noise[:150]} == {"inconclusive", "passed"}
    # WHEN the reading is off THEN the rule fails while the mean is still healthy
    found = [rule.judge(mean + size) for mean in noise[150:]]
    assert found[5].fault == found[-1].fault == fault
    assert abs(found[-1].offset) < LIMIT


@pytest.mark.parametrize(
    "means",
    [40 * [0.0] + 40 * [BIAS.fuel_span_lambda], 20 * [0.06] + 40 * [0.0]],
    ids=["a step that another fuel explains", "an offset within the limit, until it goes"],
)
def test_a_change_that_says_nothing_of_the_sensor_is_no_bias(means: list[float]) -> None:
    rule = BiasRule(BIAS, OWN, BIAS.fuel_span_lambda)
    assert "failed" not in {rule.judge(mean).outcome for mean in means}
