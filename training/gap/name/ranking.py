"""All candidates fitted on the base and the effects so far, scored on held-out blocks."""

from collections.abc import Sequence
from typing import Final

from training.gap.name.verdict import Candidate, Merit
from training.greybox.fit.case import Term, has_its_signs
from training.greybox.fit.joint import JointFit, fit
from training.healthy import scoring
from training.healthy.base_state import BaseState
from training.jobs import Progress

WIN: Final = 0.95  # of resampled blocks
HALF: Final = 0.5  # of what can be explained, for a name; of the best score, for a rival
USUAL_SHARE: Final = 0.09  # of the deviance, left to explain by an effect in another form
RANKED_CLOSELY: Final = 4  # candidates whose adequacy is worked out


def rank(
    state: BaseState,
    candidates: Sequence[Term],
    progress: Progress = lambda _: None,
    closely: int = RANKED_CLOSELY,
) -> tuple[Candidate, ...]:
    """Return all candidates, the best first; the first few, ``closely``, with their adequacy."""
    found = []
    for term in candidates:
        progress(term.name)
        fitted = fit(state.case, (*state.current.terms, term), [state.current])
        after = scoring.deviance(fitted, state.case.blocks)
        moved = scoring.moved(state.current, fitted, state.case.blocks)
        found.append((scoring.score(state.deviance, after, moved), after, fitted))
    found.sort(key=lambda each: -each[0].gain)
    best = found[0][1]
    ranking = []
    for place, (score, after, fitted) in enumerate(found):
        adequacy = adequacy_of(state, score.gain, fitted) if place < closely else None
        win = None if place == 0 else scoring.win(best, after)
        needed = state.needed(fitted.terms[-1].name)
        merit = Merit(
            score=score.gain,
            needed=needed,
            t=score.t,
            physical=has_its_signs(fitted.terms[-1], fitted.parameters[-1]),
            adequacy=adequacy,
            win=win,
        )
        ranking.append(Candidate(fitted, merit))
    return tuple(ranking)


def adequacy_of(state: BaseState, gain: float, fitted: JointFit) -> float:
    """Return a gain over the sum of itself and the ceiling's gain on the rest."""
    usual = USUAL_SHARE * float(state.deviance.sum())
    rest = float(scoring.explained(fitted, state.roof, state.case.blocks).sum())
    rest = max(rest - usual, 0.0)
    return max(gain, 0.0) / max(max(gain, 0.0) + rest, 1e-9)
