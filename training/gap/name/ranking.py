"""All candidates fitted on the base and the effects so far, scored on held-out blocks."""

from collections.abc import Sequence
from typing import Final

from training.gap.name.verdict import Candidate, Merit
from training.greybox.fit.case import Term, has_its_signs
from training.greybox.fit.joint import fit
from training.healthy import scoring
from training.healthy.base_state import BaseState
from training.jobs import Progress

WIN: Final = 0.95  # of resampled blocks
HALF: Final = 0.5  # of the best score, for a rival
USUAL_SHARE: Final = 0.09  # of what can be explained, left by an effect in another form
RANKED_CLOSELY: Final = 4  # candidates that may have begun within the recordings


def rank(
    state: BaseState, candidates: Sequence[Term], progress: Progress = lambda _: None
) -> tuple[Candidate, ...]:
    """Return all candidates, the best first."""
    found = list[Candidate]()
    for term in candidates:
        progress(f"trying {term.name}")
        fitted = fit(state.case, (*state.current.terms, term), [state.current])
        after = scoring.deviance(fitted, state.case.blocks)
        moved = scoring.moved(state.current, fitted, state.case.blocks)
        score = scoring.score(state.deviance, after, moved)
        physical = has_its_signs(term, fitted.parameters[-1])
        merit = Merit(score.gain, state.needed(term.name), score.t, physical)
        found.append(Candidate(fitted, merit, after))
    return tuple(sorted(found, key=lambda each: -each.merit.score))
