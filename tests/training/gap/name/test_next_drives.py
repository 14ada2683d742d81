"""How much more driving is likely to tell two candidates apart."""

import numpy as np
import pytest

from tests.helpers.gap.gap_drives import BASE, noisy_drive
from training.gap.name.next_drives import named_after, next_drives
from training.gap.name.ranking import WIN, rank
from training.greybox.effects import LIBRARY
from training.healthy import scoring
from training.healthy.base_state import base_state

BLOCKS = 40


@pytest.mark.parametrize("lead", [0.0, 1.0, 1.6])
def test_the_promised_probability_is_that_with_which_further_blocks_name(lead: float) -> None:
    # GIVEN blocks in which a rival leaves more by ``lead`` standard errors of their mean
    rng = np.random.default_rng(3)
    blocks = rng.standard_normal(BLOCKS)
    blocks += lead * blocks.std() / np.sqrt(BLOCKS) - blocks.mean()
    # WHEN three times as many come from where such blocks may come from
    named = []
    for _ in range(200):
        mean = rng.normal(blocks.mean(), blocks.std() / np.sqrt(BLOCKS))
        more = rng.normal(mean, blocks.std(), 3 * BLOCKS)
        named.append(scoring.win(np.zeros(4 * BLOCKS), np.concatenate([blocks, more])) >= WIN)
    # THEN the draws of all name it as often as was said
    assert np.mean(named) == pytest.approx(named_after(3, blocks), abs=0.1)


def test_driving_is_proposed_until_the_first_is_likely_named_and_none_for_one_alone() -> None:
    drive = noisy_drive(1, effect="injector_offset", value=0.05)
    state = base_state([drive], None, BASE)
    right, *rivals = rank(state, [LIBRARY[n] for n in ("injector_offset", "maf_offset", "purge")])
    present_s = float(drive.kept.sum()) * drive.period_s
    soon, late = next_drives(state.case, (right, *rivals)), next_drives(state.case, rivals)
    assert soon is not None and (soon.name, soon.seconds) == ("injector_offset", present_s)
    assert late is not None and late.seconds == 7 * present_s and late.probability < 0.8
    assert f"{round(present_s / 60.0)}\N{NO-BREAK SPACE}min more like these" in str(soon)
    assert next_drives(state.case, (right,)) is None
