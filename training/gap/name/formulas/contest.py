"""A formula of signals against the effects or the sensor fault of a verdict."""

from monitor.base.types import FloatArray
from training.gap.name.formulas.signal_screen import left_by_signal
from training.gap.name.ranking import USUAL_SHARE, WIN, against
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
    best = next(iter(left_by_signal(first).values()), first.deviance)
    return float((best - _left(first, found)).sum()) < _usual(first)


def beats(first: BaseState, rival: Candidate, found: Advance) -> float:
    """Return how often the first term of a formula beats all effects and faults; 0 if not clearly.

    It has to beat several named effects together, too. An effect whose form differs from the
    vehicle's leaves the usual share of the deviance, so the term has to explain more than that
    beyond the verdict's effects or fault.
    """
    own, left = scoring.deviance(rival.fit, first.case.blocks), _left(first, found)
    won = scoring.win(own, left)
    enough = won >= WIN and float((left - own).sum()) > _usual(first)
    return won if enough and not against(first, rival, found.first)[1] else 0.0


def _usual(first: BaseState) -> float:
    return USUAL_SHARE * float(first.deviance.sum())


def _left(first: BaseState, found: Advance) -> FloatArray:
    """Return the deviance, (n_blocks,), that the effects or the fault of a verdict leave."""
    if found.rounds:
        return found.last.deviance
    best = found.outcome.fault or next((c for c in found.first if c.merit.physical), None)
    return scoring.deviance(best.fit, first.case.blocks) if best else first.deviance
