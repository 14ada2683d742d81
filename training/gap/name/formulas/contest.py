"""A formula of signals against the effects or the sensor fault of a verdict."""

from collections.abc import Sequence

import numpy as np

from monitor.base.types import FloatArray
from training.gap.name.formulas.formula import reread
from training.gap.name.formulas.signal_screen import left_by_best_signal
from training.gap.name.ranking import HALF, USUAL_SHARE, WIN
from training.gap.name.steps import Advance
from training.gap.name.verdict import Candidate
from training.greybox.fit.joint import JointFit, fit
from training.healthy import scoring
from training.healthy.base_state import BaseState


def may_be_beaten(first: BaseState, found: Advance) -> bool:
    """Return whether plain functions of one signal explain about as much as a verdict.

    A formula's first term has one or two signals, so it may explain somewhat more than they do.
    """
    if found.outcome.verdict == "no_gap" and not found.rounds:
        return False
    left = min(float(scoring.deviance(each, first.case.blocks).sum()) for each in _said(found))
    return float(left_by_best_signal(first).sum()) - left < _usual(first)


def beats(first: BaseState, rival: Candidate, found: Advance) -> float:
    """Return how often the first term of a formula beats all effects and faults; 0 if not clearly.

    It has to beat several named effects together, too. An effect whose form differs from the
    vehicle's leaves the usual share of what can be explained, so the term has to explain more than
    that beyond the verdict's effects or fault, whichever of those that it holds alike is better.
    """
    own = _left_by(first, rival.fit)
    left = min((_left_by(first, each) for each in _said(found)), key=np.sum)
    won = scoring.win(own, left)
    enough = won >= WIN and float((left - own).sum()) > _usual(first)
    return won if enough and unbeaten(first, rival, found.first) is None else 0.0


def unbeaten(
    first: BaseState, rival: Candidate, candidates: Sequence[Candidate]
) -> Candidate | None:
    """Return the first candidate that explains half as much and that a formula does not beat."""
    own = _left_by(first, rival.fit)
    large = (c for c in candidates if c.merit.score >= HALF * rival.merit.score)
    return next((c for c in large if scoring.win(own, _left_by(first, c.fit)) < WIN), None)


def _left_by(first: BaseState, found: JointFit) -> FloatArray:
    """Return the deviance, (n_blocks,), that terms leave beside a healthy vehicle's own errors.

    Those that the healthy vehicle shows without the terms: the errors learned on healthy drives
    follow signals that an effect moves, and a formula would explain that of any effect.
    """
    case = reread(first, found).case
    return scoring.deviance(fit(case, found.terms, [found]), case.blocks)


def _usual(first: BaseState) -> float:
    whole = scoring.explained(first.current, first.roof, first.case.blocks)
    return USUAL_SHARE * float(whole.sum())


def _said(found: Advance) -> list[JointFit]:
    """Return the named effects together, or each fault and effect that a verdict holds alike."""
    if found.rounds:
        return [found.last.current]
    fault, best = found.outcome.fault, found.outcome.best
    return [c.fit for c in ((fault,) if fault else ()) + best] or [found.first[0].fit]
