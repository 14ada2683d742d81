"""Constants that suit a typical drive, and whether they hold on drives that were left out.

An effect may be strong in one drive and weak in the next: vapour of a full and of an empty
canister. Least squares follow the strongest drive then and spoil the others. So every drive has a
variance of its own, which the fit finds together with the constants.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.fit.case import Case, plain_errors, predict
from training.greybox.fit.joint import JointFit, fit

ROUNDS: Final = 4


def fit_weighted(case: Case, found: JointFit) -> tuple[Case, JointFit]:
    """Return the fit in which every drive counts by its own variance, and the case with these.

    found : a fit of the same terms, with which to begin
    Source: Seber and Wild, Nonlinear Regression, 1989, section 2.8 (iteratively reweighted).
    """
    for _ in range(ROUNDS):
        error = found.residual * np.repeat(_scales(case), _lengths(case))
        scales = [max(float(np.sqrt(np.mean(own**2))), 1.0) for own in _by_drive(case, error)]
        case = replace(case, scales=tuple(scales))
        found = fit(case, found.terms, [found])
    return case, found


def left_out_ratio(case: Case, judge: Case, before: JointFit, found: JointFit) -> float:
    """Return the RMSE of drives by a fit to the others over that ``before``, geometric mean.

    judge : the same drives, with the corrections that count
    before : the fit of ``case`` without the last terms
    One drive alone cannot tell: it is the fit's own.
    """
    old, new, n = _rms(judge, before), _rms(judge, found), len(case.drives)
    if n > 1:
        left = [fit(_without(case, i), found.terms, [found]) for i in range(n)]
        new = np.array([_rms(judge, each)[i] for i, each in enumerate(left)])
    return float(np.exp(np.mean(np.log(new / old))))


def _without(case: Case, i: int) -> Case:
    """Return the case without a drive."""
    return replace(
        case,
        drives=(*case.drives[:i], *case.drives[i + 1 :]),
        corrections=(*case.corrections[:i], *case.corrections[i + 1 :]),
        shrinks=(*case.shrinks[:i], *case.shrinks[i + 1 :]),
        scales=(*case.scales[:i], *case.scales[i + 1 :]),
    )


def _rms(case: Case, found: JointFit) -> FloatArray:
    """Return the RMSE of every drive in phi, (n_drives,)."""
    e = plain_errors(case, predict(case, found.base, found.terms, found.parameters))
    return np.array([np.sqrt(np.mean(own**2)) for own in _by_drive(case, e)])


def _lengths(case: Case) -> list[int]:
    return [int(kept.sum()) for kept in case.kept]


def _scales(case: Case) -> list[float]:
    return list(case.scales) or [1.0] * len(case.drives)


def _by_drive(case: Case, values: FloatArray) -> list[FloatArray]:
    """Return values (m,) of the kept samples, drive by drive."""
    return np.split(values, np.cumsum(_lengths(case))[:-1])
