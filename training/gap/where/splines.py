"""Cross-fitted functions of one variable: each block is judged by a fit to the other blocks."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.interpolate import BSpline

from monitor.base.types import FloatArray, IntArray
from training.gap.config import CONFIG
from training.greybox.fit.comparison import Stack

LIMITS: Final = CONFIG.splines


@dataclass(frozen=True, slots=True)
class Basis:
    """Cubic B-splines between quantiles of a variable; straight lines if it takes few values."""

    knots: FloatArray  # with repeated ends, or the two ends alone

    @classmethod
    def of(cls, values: FloatArray, knots: int = LIMITS.knots) -> "Basis":
        """Return the basis for a variable of these values (m,)."""
        low, high = (float(v) for v in np.percentile(values, [0.5, 99.5]))
        inside = values[(values >= low) & (values <= high)]
        inner = np.unique(np.quantile(inside, np.linspace(0.0, 1.0, knots + 1)))
        if len(inner) < 4:  # a variable that mostly rests has its quantiles at one value
            inner = np.unique(np.quantile(np.unique(inside), np.linspace(0.0, 1.0, knots + 1)))
        if len(inner) < 3:
            return cls(np.array([float(values.min()), float(values.max())]))
        return cls(np.concatenate([np.repeat(inner[0], 3), inner, np.repeat(inner[-1], 3)]))

    @property
    def ends(self) -> tuple[float, float]:
        """Return the range within which the functions move; they are constant outside."""
        return float(self.knots[0]), float(self.knots[-1])

    def __call__(self, values: FloatArray) -> FloatArray:
        """Return the functions at ``values`` (n,), shape (n, k); a constant lies in their span."""
        low, high = self.ends
        x = np.clip(values, low, high)
        if len(self.knots) == 2:
            part = (x - low) / (high - low)
            return np.column_stack([1.0 - part, part])
        return np.asarray(BSpline.design_matrix(x, self.knots, 3).toarray())


@dataclass(frozen=True, slots=True)
class Normal:
    """Normal equations of every block: the sums that least squares needs."""

    gram: FloatArray  # (n_blocks, k, k)
    right: FloatArray  # (n_blocks, k)
    squares: FloatArray  # (n_blocks,)

    def error(self, coefficients: FloatArray) -> FloatArray:
        """Return the sum of squares that coefficients (n_blocks, k) leave, block by block."""
        fitted = np.einsum("bi,bij,bj->b", coefficients, self.gram, coefficients)
        cross = np.einsum("bi,bi->b", coefficients, self.right)
        return np.asarray(self.squares - 2.0 * cross + fitted)


def normal(design: FloatArray, blocks: Stack) -> Normal:
    """Return the normal equations of ``design`` (m, k) against the residual."""
    starts = np.searchsorted(blocks.block, np.arange(blocks.n_blocks + 1))
    gram = np.empty((blocks.n_blocks, design.shape[1], design.shape[1]))
    right = np.empty(gram.shape[:2])
    for i, (first, last) in enumerate(pairwise(starts)):
        rows = design[first:last]
        gram[i] = rows.T @ rows
        right[i] = rows.T @ blocks.residual[first:last]
    return Normal(gram, right, blocks.sums(blocks.residual**2))


def solve(gram: FloatArray, right: FloatArray) -> FloatArray:
    """Return coefficients (k,) or (d, k) of least squares with a light smoothing."""
    k = gram.shape[-1]
    level = np.trace(gram, axis1=-2, axis2=-1)[..., np.newaxis, np.newaxis] / k + 1e-30
    bend = np.diff(np.eye(k), 2, axis=0) if k > 2 else np.zeros((1, k))
    ridge = level * (LIMITS.smoothing * bend.T @ bend + 1e-8 * np.eye(k))
    return np.linalg.solve(gram + ridge, right[..., np.newaxis])[..., 0]


def held_out(equations: Normal, fold: IntArray) -> FloatArray:
    """Return coefficients (n_blocks, k), every block's from the blocks of other folds."""
    found = np.empty(equations.right.shape)
    for one in np.unique(fold):
        others = fold != one
        found[fold == one] = solve(equations.gram[others].sum(0), equations.right[others].sum(0))
    return found


def healthy_coefficients(healthy: Normal) -> FloatArray:
    """Return coefficients (k,) of the model's error on healthy recordings."""
    return solve(healthy.gram.sum(0), healthy.right.sum(0))


def common_coefficients(new: Normal, healthy: Normal, fold: IntArray) -> FloatArray:
    """Return coefficients (n_blocks, k) from healthy and new blocks of other folds together.

    Where the new recordings are longer, a healthy sample weighs up to ``healthy_weight_max`` new
    ones. Beside these coefficients, those of the new blocks alone lose on held-out blocks unless
    the dependence has changed: they come from less data.
    """
    ratio = float(np.trace(new.gram.sum(0)) / max(np.trace(healthy.gram.sum(0)), 1e-30))
    weight = float(np.clip(ratio, 1.0, LIMITS.healthy_weight_max))
    both = Normal(
        np.concatenate([new.gram, weight * healthy.gram]),
        np.concatenate([new.right, weight * healthy.right]),
        np.concatenate([new.squares, weight * healthy.squares]),
    )
    with_healthy = np.concatenate([fold, np.full(len(healthy.squares), -1)])
    return held_out(both, with_healthy)[: len(fold)]


def offset(
    equations: Normal, coefficients: FloatArray, level: FloatArray, fold: IntArray
) -> FloatArray:
    """Return coefficients (n_blocks, k) with the mean that blocks of other folds ask for.

    level : (k,) coefficients that make a constant of 1
    """
    found = coefficients.copy()
    for one in np.unique(fold):
        gram, right = equations.gram[fold != one].sum(0), equations.right[fold != one].sum(0)
        now = coefficients[fold == one][0]
        found[fold == one] += level * (level @ (right - gram @ now)) / (level @ gram @ level)
    return found
