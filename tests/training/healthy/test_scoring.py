"""Scores of candidates on held-out blocks, on drives of plain formulas."""

import numpy as np

from tests.helpers.gap.gap_drives import case_of, noisy_drive
from training.greybox.chain import Constants
from training.greybox.effects import LIBRARY
from training.greybox.fit.joint import fit
from training.healthy import scoring


def test_a_real_effect_scores_and_a_useless_one_does_not() -> None:
    case = case_of(
        noisy_drive(1, effect="purge", value=0.5), noisy_drive(2, effect="purge", value=0.5)
    )
    alone = fit(case, (), [Constants()])
    before = scoring.deviance(alone, case.blocks)
    after = {
        name: scoring.deviance(fit(case, (LIBRARY[name],), [alone]), case.blocks)
        for name in ("purge", "back_pressure")
    }
    assert scoring.score(before, after["purge"]).gain > 100.0
    assert scoring.score(before, after["back_pressure"]).t < 3.0
    assert scoring.win(after["purge"], after["back_pressure"]) > 0.95


def test_blocks_in_which_two_models_agree_do_not_count_for_t() -> None:
    before = np.full(40, 300.0)
    after = before.copy()
    after[:10] -= 50.0 + np.arange(10)
    moved = np.where(np.arange(40) < 10, 60.0, 0.0)
    assert scoring.score(before, after, moved).t > 2.0 * scoring.score(before, after).t
    assert scoring.score(before, after, np.zeros(40)).t == 0.0


def test_a_ceiling_that_knows_nothing_of_the_errors_leaves_them() -> None:
    # GIVEN errors of which a few lie far out, and many columns that say nothing of them
    rng = np.random.default_rng(3)
    errors = rng.standard_normal(3000)
    errors[::300] *= 20.0
    roof, blocks = rng.standard_normal((3000, 150)), np.arange(3000) // 100
    # THEN held-out blocks are hardly worse with it
    left = scoring.left_by(roof, np.empty((3000, 0)), errors, blocks)
    before, after = (scoring.by_block(each, blocks).sum() for each in (errors, left))
    assert after < 1.002 * before
    # and most of what one of the columns does is taken away
    moved = errors + roof[:, 7]
    left = scoring.left_by(roof, np.empty((3000, 0)), moved, blocks)
    without, after = (scoring.by_block(each, blocks).sum() for each in (moved, left))
    assert after - before < 0.3 * (without - before)
