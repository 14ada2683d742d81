"""Effects one after the other: each of a pair is judged beside the other."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import pytest

from tests.helpers.gap.gap_simulated import known, two_drives
from training.gap.name import steps
from training.gap.name.decision import StepOutcome
from training.gap.name.ranking import rank
from training.gap.name.steps import Advance, advance
from training.gap.name.verdict import Candidate
from training.greybox.effects import LIBRARY
from training.healthy.base_state import BaseState, base_state

ALL = dict.fromkeys(("wall_film", "maf_offset", "exhaust_leak", "none", "unknown"), 0.2)
TRIED = tuple(LIBRARY[n] for n in ("wall_film", "maf_offset", "exhaust_leak"))


@cache
def ranked() -> tuple[BaseState, tuple[Candidate, ...]]:
    state = base_state(two_drives(2_200_140, ("wall_film", 4.0)), known(), known().base)
    ranking = rank(state, TRIED, lambda _: None)
    return state, tuple(next(c for c in ranking if c.name == term.name) for term in TRIED)


Answers = Callable[..., StepOutcome]


def advanced(monkeypatch: pytest.MonkeyPatch, answers: Answers) -> Advance:
    """Two steps whose outcomes follow from the effects under them."""
    monkeypatch.setattr(
        steps,
        "step",
        lambda state, *_: replace(answers(*(t.name for t in state.current.terms)), posterior=ALL),
    )
    return advance(ranked()[0], TRIED, 2, True, lambda _: None)


def test_an_effect_that_alone_stood_for_another_gives_way_once_the_second_is_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # GIVEN a wall film beside a leak, which together look like an offset of the air meter
    _, every = ranked()
    film, offset, leak = every

    def answers(*under: str) -> StepOutcome:
        best = {(): offset, ("maf_offset",): film, ("wall_film",): leak}[under]
        return StepOutcome("named", every, best=(best,))

    # WHEN the film is found beside the offset, THEN the leak is found beside the film
    found = advanced(monkeypatch, answers)
    assert [r.effect.name for r in found.rounds] == ["wall_film", "exhaust_leak"]
    assert found.last.current is leak.fit


def test_a_first_effect_that_has_rivals_beside_the_second_is_held_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, every = ranked()
    film, offset, leak = every

    def answers(*under: str) -> StepOutcome:
        if under == ("wall_film",):
            return StepOutcome("ambiguous", every, best=(leak, offset))
        return StepOutcome("named", every, best=(film if under else offset,))

    found = advanced(monkeypatch, answers)
    assert [r.effect.name for r in found.rounds] == ["wall_film"]
    assert found.outcome.verdict == "named"
    assert found.beside == (leak, offset)


@pytest.mark.parametrize("verdict", ["named", "no_gap"])
def test_a_first_effect_that_nothing_replaces_stays(
    verdict: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, every = ranked()
    film, offset, _ = every

    def answers(*under: str) -> StepOutcome:
        if under == ("wall_film",) and verdict == "no_gap":
            return StepOutcome("no_gap", every)
        return StepOutcome("named", every, best=(film if under == ("maf_offset",) else offset,))

    found = advanced(monkeypatch, answers)
    assert [r.effect.name for r in found.rounds] == ["maf_offset", "wall_film"]
    assert found.outcome.verdict == "named"
