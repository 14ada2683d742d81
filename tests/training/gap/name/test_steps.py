"""Effects one after the other."""

from functools import cache

import pytest

from tests.helpers.gap.gap_simulated import known, two_drives
from training.gap.name import steps
from training.gap.name.decision import StepOutcome
from training.gap.name.ranking import rank
from training.gap.name.steps import advance
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


@pytest.mark.parametrize(("verdict", "beside"), [("ambiguous", (0, 2)), ("no_gap", ())])
def test_a_name_stays_whatever_cannot_be_named_on_top_of_it(
    verdict: Verdict, beside: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN a first step that names an effect, and a second one that names none on top of it
    state, every = ranked()
    rivals = tuple(every[i] for i in beside)
    said = iter(
        [
            StepOutcome("named", every, best=every[1:2], posterior=ALL),
            StepOutcome(verdict, every, best=rivals, posterior=ALL),
        ]
    )
    monkeypatch.setattr(steps, "step", lambda *_: next(said))
    # WHEN both are done THEN the name stays
    found = advance(state, TRIED, 2, True, lambda _: None)
    assert [r.effect.name for r in found.rounds] == ["maf_offset"]
    assert found.outcome.verdict == "named"
    assert found.beside == rivals
