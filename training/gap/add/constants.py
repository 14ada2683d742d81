"""Constants of the named effects: from all drives, and from all but one in turn, or a few of many.

There are two sets, of which a chain keeps the one that predicts the left-out drives better. A
network keeps the first one: in the second, effects take on what it makes wrong on this vehicle.

1. Those of the naming. It corrects the chain by its error on healthy drives and whitens errors:
   that tells effects from each other, but takes part of an effect's size, because the corrections
   follow signals that the effect has moved.
2. Those fitted to the plain errors of the model itself.

An effect may be strong in one drive and weak in the next: vapour of a full and of an empty
canister. Least squares follow the strongest drive then and spoil the others. So every drive has a
variance of its own, which the fit finds together with the constants.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from monitor.base.types import FloatArray
from training.gap.inputs.subject import Subject
from training.gap.name.verdict import Naming
from training.greybox.chain import Constants
from training.greybox.fit.case import Case, plain_errors, predict
from training.greybox.fit.drive import ChainDrive
from training.greybox.fit.joint import JointFit, fit
from training.healthy import scoring
from training.healthy.base_state import base_state
from training.healthy.behaviour import Healthy
from training.recordings.prediction import predicted_phi

ROUNDS: Final = 4
GROUPS_MOST: Final = 4  # of drives, each left out in turn


@dataclass(frozen=True, slots=True)
class EffectConstants:
    """The named effects with their constants, and those of the chain under them."""

    whole: JointFit  # to all drives
    left_out: tuple[JointFit, ...]  # per group of drives, to all others; empty of one drive
    ratio: float  # RMSE of the left-out drives with them over that without, geometric mean


def constants_of(
    subject: Subject, naming: Naming, known: Healthy | None, start: Constants
) -> EffectConstants:
    """Return the constants that predict the drives best, each by a fit to others."""
    last = naming.answer.effects[-1].fit
    state = base_state(subject.drives, known, known.base if known else start)
    judge = replace(
        scoring.as_they_are(state.case, state.current),
        corrections=model_corrections(subject, state.case, state.current),
    )
    # An effect that varies between drives would follow the drive in which it is strongest.
    varies = any(getattr(term, "varies", False) for term in last.terms)
    every = groups(len(subject.drives))
    of = [every[i] for i in _numbers(state.case, subject.drives)]
    cases = (state.case, judge) if subject.is_greybox and not varies else (state.case,)
    tried = [fit_and_leave_out(case, last, of) for case in cases]
    ratios = [left_out_ratio(judge, state.current, *each, of) for each in tried]
    whole, left = tried[int(np.argmin(ratios))]
    return EffectConstants(whole, tuple(left), min(ratios))


def fit_weighted(case: Case, found: JointFit) -> tuple[Case, JointFit]:
    """Return the fit in which every drive counts by its own variance, and the case with these.

    found : a fit of the same terms, with which to begin
    Source: Seber and Wild, Nonlinear Regression, 1989, section 2.8 (iteratively reweighted).
    """
    lengths = [len(rows) for rows in case.rows]
    for _ in range(ROUNDS):
        error = found.residual * np.repeat(case.scales or [1.0] * len(lengths), lengths)
        scales = [max(float(np.sqrt(np.mean(own**2))), 1.0) for own in _by_drive(case, error)]
        case = replace(case, scales=tuple(scales))
        found = fit(case, found.terms, [found])
    return case, found


def groups(n: int) -> list[int]:
    """Return for each of n drives the group with which it is left out.

    >>> groups(6)
    [0, 1, 2, 3, 0, 1]
    """
    return [i % GROUPS_MOST for i in range(n)]


def fit_and_leave_out(
    case: Case, last: JointFit, of: Sequence[int]
) -> tuple[JointFit, list[JointFit]]:
    """Return the fit to all drives, and those without each group, none if a group is all.

    of : group of each drive
    """
    case, found = fit_weighted(case, fit(case, last.terms, [last]))
    left = [[i for i, own in enumerate(of) if own != group] for group in range(GROUPS_MOST)]
    if not all(left):
        return found, []
    return found, [
        found if len(rows) == len(of) else fit(_part(case, rows), found.terms, [found])
        for rows in left
    ]


def left_out_ratio(
    judge: Case, before: JointFit, whole: JointFit, left: Sequence[JointFit], of: Sequence[int]
) -> float:
    """Return ``EffectConstants.ratio``; one drive alone is judged by its own fit."""
    old, new = _rms(judge, before), _rms(judge, whole)
    if left:
        runs = [_rms(judge, each) for each in left]
        new = np.array([runs[group][i] for i, group in enumerate(of)])
    return float(np.exp(np.mean(np.log(new / old))))


def _numbers(case: Case, drives: Sequence[ChainDrive]) -> list[int]:
    """Return which of all drives those of a case are: some may be left out, names may be alike."""
    at = {id(drive.phi_measured): i for i, drive in enumerate(drives)}
    return [at[id(drive.phi_measured)] for drive in case.drives]


def _part(case: Case, rows: Sequence[int]) -> Case:
    """Return the case of some of its drives."""
    of_drives = {n: getattr(case, n) for n in ("drives", "corrections", "shrinks", "scales")}
    some: dict[str, Any] = {n: tuple(v[i] for i in rows) for n, v in of_drives.items() if v}
    return replace(case, **some)


def _rms(case: Case, found: JointFit) -> FloatArray:
    """Return the RMSE of every drive in phi, (n_drives,)."""
    e = plain_errors(case, predict(case, found.base, found.terms, found.parameters))
    return np.array([np.sqrt(np.mean(own**2)) for own in _by_drive(case, e)])


def _by_drive(case: Case, values: FloatArray) -> list[FloatArray]:
    """Return values (m,) of the kept samples, drive by drive."""
    return np.split(values, np.cumsum([len(rows) for rows in case.rows])[:-1])


def model_corrections(subject: Subject, case: Case, current: JointFit) -> tuple[FloatArray, ...]:
    """Return what the model predicts beyond the chain without the effects, (n,) per drive."""
    if subject.is_greybox:
        return tuple(np.zeros(len(drive)) + drive.moved_phi for drive in case.drives)
    runs = predicted_phi(subject.material.model, subject.material.recordings)
    alone = replace(case, corrections=tuple(np.zeros(len(drive)) for drive in case.drives))
    chain = predict(alone, current.base, (), ())
    numbers = _numbers(case, subject.drives)
    return tuple(runs[i] - phi for i, phi in zip(numbers, chain, strict=True))
