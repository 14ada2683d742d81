"""A formula of signals against the effects or the sensor fault of a verdict."""

from collections.abc import Sequence

from monitor.base.types import FloatArray
from training.gap.name.formulas.signal_screen import left_by_best_signal
from training.gap.name.ranking import HALF, USUAL_SHARE, WIN
from training.gap.name.steps import Advance
from training.gap.name.verdict import Candidate
from training.healthy import scoring
from training.healthy.base_state import BaseState


def may_be_beaten(first: BaseState, found: Advance) -> bool:
    """Return whether plain functions of one signal explain about as much as a verdict.

    A formula's first term has one or two signals, so it may explain somewhat more than they do.
    """
    if found.outcome.verdict == "no_gap" and not found.rounds:
        return False
    return float((left_by_best_signal(first) - _left(found)).sum()) < _usual(first)


def beats(first: BaseState, rival: Candidate, found: Advance) -> float:
    """Return how often the first term of a formula beats all effects and faults; 0 if not clearly.

    It has to beat several named effects together, too. An effect whose form differs from the
    vehicle's leaves the usual share of what can be explained, so the term has to explain more than
    that beyond the verdict's effects or fault.
    """
    own, left = rival.left, _left(found)
    won = scoring.win(own, left)
    enough = won >= WIN and float((left - own).sum()) > _usual(first)
    return won if enough and unbeaten(rival, found.first) is None else 0.0


def unbeaten(rival: Candidate, candidates: Sequence[Candidate]) -> Candidate | None:
    """Return the first candidate that explains half as much and that a formula does not beat."""
    large = (c for c in candidates if c.merit.score >= HALF * rival.merit.score)
    return next((c for c in large if scoring.win(rival.left, c.left) < WIN), None)


def _usual(first: BaseState) -> float:
    whole = scoring.explained(first.current, first.roof, first.case.blocks)
    return USUAL_SHARE * float(whole.sum())


def _left(found: Advance) -> FloatArray:
    """Return the deviance, (n_blocks,), that the effects or the fault of a verdict leave."""
    if found.rounds:
        return found.last.deviance
    return (found.outcome.fault or (*found.outcome.best, *found.first)[0]).left
