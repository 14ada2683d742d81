"""Effects one after the other."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import pytest

from tests.helpers.gap.gap_simulated import known, two_drives
from training.gap.name import steps
from training.gap.name.decision import StepOutcome
from training.gap.name.ranking import rank
from training.gap.name.steps import Advance, advance
from training.gap.name.verdict import Candidate, Verdict
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


def test_an_effect_that_is_named_on_top_of_another_stands_beside_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, every = ranked()
    film, offset, _ = every
    named = {(): offset, ("maf_offset",): film}
    found = advanced(monkeypatch, lambda *under: StepOutcome("named", every, best=(named[under],)))
    assert [r.effect.name for r in found.rounds] == ["maf_offset", "wall_film"]
    assert found.last.current is film.fit


@pytest.mark.parametrize(("verdict", "beside"), [("ambiguous", (0, 2)), ("no_gap", ())])
def test_a_name_stays_whatever_cannot_be_named_on_top_of_it(
    verdict: Verdict, beside: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, every = ranked()
    rivals = tuple(every[i] for i in beside)

    def answers(*under: str) -> StepOutcome:
        if under:
            return StepOutcome(verdict, every, best=rivals)
        return StepOutcome("named", every, best=(every[1],))

    found = advanced(monkeypatch, answers)
    assert [r.effect.name for r in found.rounds] == ["maf_offset"]
    assert found.outcome.verdict == "named"
    assert found.beside == rivals
