"""Probabilities of hypotheses: evidence of errors, form, freedom, rivals, and a gap at all."""

from dataclasses import replace

import numpy as np
import pytest

from tests.training.gap.name.test_guards import explained
from training.gap.name.evidence import Directions, freedom
from training.gap.name.hypotheses import GapHypothesis
from training.gap.name.onset import beginnings
from training.gap.name.posterior import posterior
from training.greybox.effects.form.effect import Parameter
from training.healthy.scoring import Ceiling

SAMPLES = 4000
RNG = np.random.default_rng(11)
COLUMNS = RNG.standard_normal((SAMPLES, 30))
NOISE = RNG.standard_normal(SAMPLES)
DIRECTIONS = Directions.of(Ceiling(COLUMNS))
BLOCKS = np.full(40, 100.0)


def of(name: str, nats: float, lost: float | None = None, **other: float) -> GapHypothesis:
    """A hypothesis; ``lost`` is by how much each block prefers the best candidate."""
    kind = "unknown" if name == "unknown" else "effect"
    deviance = None if lost is None else BLOCKS + lost
    return replace(GapHypothesis(name, kind, False, nats, 1.0, deviance), **other)


def log_evidence(errors: np.ndarray, energy: float) -> float:
    return float(DIRECTIONS.log_evidence(DIRECTIONS.seen(errors), np.array([energy]))[0])


def test_errors_that_functions_explain_are_likelier_with_a_cause_and_noise_without() -> None:
    moved = NOISE + 20.0 * COLUMNS[:, 3] / np.linalg.norm(COLUMNS[:, 3])
    for errors, has_a_cause in ((moved, True), (NOISE, False)):
        seen = DIRECTIONS.seen(errors)
        none = log_evidence(errors, 1.0)
        assert (DIRECTIONS.of_any(seen, 1.0) > none) == has_a_cause


def test_an_effect_in_another_form_is_forgiven_in_proportion_to_its_size() -> None:
    # GIVEN what a strong effect leaves of itself because the vehicle's has another form
    left = NOISE + 8.0 * COLUMNS[:, 3] / np.linalg.norm(COLUMNS[:, 3])
    # THEN it counts less against an effect that explains much than against one that explains little
    strong, weak = log_evidence(left, 0.5**2 * 2000.0), log_evidence(left, 0.5**2 * 20.0)
    clean = [log_evidence(NOISE, 0.5**2 * size) for size in (2000.0, 20.0)]
    assert clean[0] - strong < 0.5 * (clean[1] - weak)


def test_a_constant_that_the_data_hold_tightly_costs_more_than_one_they_leave_open() -> None:
    size = Parameter("size", "-", -1.0, 1.0, (0.1,))
    tight, loose = (freedom([size], np.array([error])) for error in (1e-4, 1e-1))
    assert tight > loose + 5.0


def test_probabilities_sum_to_one_and_no_gap_is_likeliest_where_nothing_gains() -> None:
    found = posterior([of("purge", 12.0, 0.0), of("wall_film", 5.0, 1.0), of("unknown", -200.0)])
    assert sum(found.values()) == pytest.approx(1.0)
    assert next(iter(found)) == "none"
    assert found["none"] > 0.95


def test_the_candidate_that_held_out_blocks_prefer_is_likeliest_and_an_equal_one_shares() -> None:
    found = posterior([of("purge", 900.0, 0.0), of("wall_film", 700.0, 20.0), of("unknown", 500.0)])
    assert found["purge"] > 0.95
    found = posterior([of("purge", 900.0, 0.0), of("wall_film", 899.0, 0.1), of("unknown", 500.0)])
    assert found["purge"] < 0.7
    assert found["purge"] + found["wall_film"] > 0.95


def test_a_cause_that_explains_far_more_than_the_best_effect_is_unknown() -> None:
    found = posterior([of("purge", 300.0, 0.0), of("unknown", 900.0)])
    assert next(iter(found)) == "unknown"


def test_a_gain_that_healthy_drives_give_as_well_is_no_gap() -> None:
    assert posterior([of("maf_offset", 300.0, 0.0)])["none"] < 0.05
    assert posterior([of("maf_offset", 300.0, 0.0, scale=6.0)])["none"] > 0.8


def test_a_candidate_that_is_absent_at_first_begins_where_it_does() -> None:
    # GIVEN a gap that is a signature from 285 s on
    case, before, after = explained((np.arange(6000) > 2500).astype(float))
    columns = np.column_stack([after.residual, before.residual])
    directions = Directions.of(Ceiling(columns))
    seen = directions.seen(before.residual)
    # WHEN its beginning is looked for
    found = list(beginnings(case, before, after, directions, seen))
    best = min(found, key=lambda each: float(each.seen.squares))
    # THEN it is found, and little is left
    assert best.place[0] == "drive 1"
    assert best.place[1] == pytest.approx(285.0, abs=75.0)
    assert float(best.seen.squares) == pytest.approx(float(seen.squares) - best.gained)
    assert best.gained > 0.8 * float(((after.residual - before.residual)[2500:] ** 2).sum())
