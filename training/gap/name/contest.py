"""A formula of signals against the effects or the sensor fault of a verdict."""

from training.gap.name import scoring
from training.gap.name.formula import Formula
from training.gap.name.ranking import WIN, State, adequacy_of, against
from training.gap.name.steps import Advance


def leaves_something(first: State, found: Advance) -> bool:
    """Return whether the ceiling explains more of a gap than a verdict's effects or fault."""
    if found.outcome.verdict == "no_gap" and not found.rounds:
        return False
    if found.rounds:
        fitted, deviance = found.last.current, found.last.deviance
    else:
        best = found.outcome.fault or next((c for c in found.first if c.merit.physical), None)
        if best is None:
            return True
        fitted, deviance = best.fit, scoring.deviance(best.fit, first.case.blocks)
    return adequacy_of(first, float((first.deviance - deviance).sum()), fitted) < 1.0


def beats(first: State, formula: Formula, found: Advance) -> bool:
    """Return whether the first term of a formula clearly beats all effects and faults.

    It has to beat several named effects together, too.
    """
    if formula.rival is None or against(first, formula.rival, found.first)[1]:
        return False
    own = scoring.deviance(formula.rival.fit, first.case.blocks)
    return scoring.win(own, found.last.deviance) >= WIN
