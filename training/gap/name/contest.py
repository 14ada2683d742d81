"""A formula of signals against the effects or the sensor fault of a verdict."""

from monitor.base.types import FloatArray
from training.gap.name import scoring
from training.gap.name.formula import Formula
from training.gap.name.ranking import USUAL_SHARE, WIN, State, against
from training.gap.name.steps import Advance


def beats(first: State, formula: Formula, found: Advance) -> bool:
    """Return whether the first term of a formula clearly beats all effects and faults.

    It has to beat several named effects together, too. An effect whose form differs from the
    vehicle's leaves the usual share of the deviance, so the term has to explain more than that
    beyond the verdict's effects or fault.
    """
    if formula.rival is None or against(first, formula.rival, found.first)[1]:
        return False
    own = scoring.deviance(formula.rival.fit, first.case.blocks)
    left = _left(first, found)
    usual = USUAL_SHARE * float(first.deviance.sum())
    return scoring.win(own, left) >= WIN and float((left - own).sum()) > usual


def _left(first: State, found: Advance) -> FloatArray:
    """Return the deviance, (n_blocks,), that the effects or the fault of a verdict leave."""
    if found.rounds:
        return found.last.deviance
    best = found.outcome.fault or next((c for c in found.first if c.merit.physical), None)
    return scoring.deviance(best.fit, first.case.blocks) if best else first.deviance
