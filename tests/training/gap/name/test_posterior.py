"""Probabilities of hypotheses: in how many resamples of the blocks each is the answer."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest

from tests.helpers.gap.gap_simulated import known, two_drives
from training.gap.name.posterior import Posterior, on_top, posterior
from training.gap.name.ranking import rank
from training.gap.name.verdict import Candidate
from training.greybox.effects import LIBRARY
from training.healthy.base_state import BaseState, base_state


@pytest.fixture(scope="module")
def filmed() -> tuple[BaseState, tuple[Candidate, ...]]:
    """Return drives with a wall film, and the film and a fuel cut's tail fitted to them."""
    state = base_state(two_drives(2_200_140, ("wall_film", 4.0)), known(), known().base)
    return state, rank(state, [LIBRARY["wall_film"], LIBRARY["fuel_cut_tail"]])


def weighed(state: BaseState, ranking: Sequence[Candidate], **merit: Any) -> Posterior:
    """Return the probabilities, the first candidate with other merits."""
    first = replace(ranking[0], merit=replace(ranking[0].merit, **merit))
    return posterior(state, [first, *ranking[1:]], state.deviance)


def test_what_resampled_blocks_prefer_is_likeliest_and_all_sums_to_one(
    filmed: tuple[BaseState, tuple[Candidate, ...]],
) -> None:
    found = weighed(*filmed)
    assert found["wall_film"] > 0.95
    assert sum(found.values()) == pytest.approx(1.0)


def test_an_effect_in_the_direction_that_it_cannot_have_is_a_hypothesis_of_its_own(
    filmed: tuple[BaseState, tuple[Candidate, ...]],
) -> None:
    found = weighed(*filmed, physical=False)
    assert found["wall_film reversed"] > 0.95
    assert "wall_film" not in found


def test_a_candidate_that_leaves_most_of_what_can_be_explained_speaks_for_another_cause(
    filmed: tuple[BaseState, tuple[Candidate, ...]],
) -> None:
    state, (_, tail) = filmed
    found = weighed(state, (tail,), needed=0.0)
    assert found["fuel_cut_tail"] < 0.05
    assert found["unknown"] > 0.5


def test_a_gain_that_healthy_drives_give_as_well_is_no_gap() -> None:
    state = base_state(two_drives(2_200_120), known(), known().base)
    ranking = rank(state, [LIBRARY["wall_film"]])
    assert posterior(state, ranking, state.deviance)["none"] > 0.95


def test_a_second_step_parts_the_first_ones_effect_from_pairs_with_it() -> None:
    first = {"wall_film": 0.7, "purge": 0.1, "none": 0.1, "unknown": 0.1}
    found = on_top(first, "wall_film", "wall_film", {"purge": 0.5, "none": 0.25, "unknown": 0.25})
    pair = {"wall_film+purge": 0.4, "wall_film": 0.2, "unknown": 0.2, "purge": 0.1, "none": 0.1}
    assert found == pytest.approx(pair)
