"""Errors on blocks that a joint fit has not seen."""

import numpy as np

from monitor.base.types import FloatArray, IntArray
from training.greybox.fit.case import Case, plain_errors, predict
from training.greybox.fit.comparison import FOLDS
from training.greybox.fit.joint import JointFit, ParameterLayout


def held_out(found: JointFit, blocks: IntArray) -> FloatArray:
    """Return each sample's error (m,) in sigma by the fit without the fold of its block.

    The fit without a fold is one Gauss-Newton step away from the whole fit, which is enough for a
    dozen constants and thousands of samples.
    """
    fold = blocks % FOLDS
    result = found.residual.copy()
    for f, step in enumerate(_steps_without(found, fold)):
        result[fold == f] += found.jacobian[fold == f] @ step
    return result


def held_out_rmse(case: Case, found: JointFit) -> float:
    """Return the RMSE in phi over all blocks, each predicted by the fit without its fold."""
    fold = case.blocks % FOLDS
    layout = ParameterLayout(case, found.terms)
    low, high = layout.limits
    centre = layout.join(found.base, [own.tolist() for own in found.parameters])
    squares = 0.0
    for f, step in enumerate(_steps_without(found, fold)):
        base, own = layout.split(np.clip(centre + step, low, high))
        e = plain_errors(case, predict(case, base, found.terms, own))
        squares += float((e[fold == f] ** 2).sum())
    return float(np.sqrt(squares / len(fold)))


def _steps_without(found: JointFit, fold: IntArray) -> list[FloatArray]:
    """Return the step of the constants (p,) for each fold that is left out."""
    steps = []
    for f in range(FOLDS):
        own = found.jacobian[fold == f]
        rest = found.hessian - own.T @ own
        ridge = 1e-9 * np.diag(np.diag(found.hessian) + 1e-12)
        steps.append(np.linalg.solve(rest + ridge, own.T @ found.residual[fold == f]))
    return steps
