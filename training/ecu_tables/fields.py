"""A field over speed and load: bilinear between knots, with a smooth Gaussian prior.

The knots follow the drives and not the axes of a table, so that the estimate of a cell does not
depend on how fine the table is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from monitor.base.types import FloatArray, IntArray

KNOTS: Final = 5  # in each direction
REACH: Final = 1.2  # knots: length over which the prior holds neighbours together
NUGGET: Final = 0.02  # of the prior's variance, that no neighbour shares
EDGES: Final = (1.0, 99.0)  # percentiles of the samples between which the knots stand


@dataclass(frozen=True)
class Weights:
    """Bilinear weights of n places: four knots each."""

    at: IntArray  # (n, 4)
    share: FloatArray  # (n, 4), rows add up to 1
    n_knots: int

    def apply(self, knots: FloatArray) -> FloatArray:
        """Return the field (n,) with these values at the knots (n_knots,)."""
        return np.asarray(np.einsum("nk,nk->n", knots[self.at], self.share))

    @cached_property
    def dense(self) -> FloatArray:
        """Return the weights as a matrix (n, n_knots)."""
        full = np.zeros((len(self.at), self.n_knots))
        np.put_along_axis(full, self.at, self.share, axis=1)
        return full


@dataclass(frozen=True, slots=True)
class Grid:
    """Knots over the logarithms of speed and load."""

    speeds: FloatArray  # (n,) log rpm
    loads: FloatArray  # (m,) log of the load

    @property
    def size(self) -> int:
        """Return the number of knots."""
        return len(self.speeds) * len(self.loads)

    def weights(self, rpm: FloatArray, load: FloatArray) -> Weights:
        """Return the weights of places (n,); beyond the knots the field is constant."""
        i, a = _place(np.log(rpm), self.speeds)
        j, b = _place(np.log(np.maximum(load, 1.0)), self.loads)
        n = len(self.loads)
        at = np.column_stack([i * n + j, i * n + j + 1, (i + 1) * n + j, (i + 1) * n + j + 1])
        share = np.column_stack([(1 - a) * (1 - b), (1 - a) * b, a * (1 - b), a * b])
        return Weights(at, share, self.size)

    def precision(self, sd: float) -> FloatArray:
        """Return the inverse of the prior's covariance (size, size)."""
        i, j = np.divmod(np.arange(self.size), len(self.loads))
        apart = (i[:, None] - i) ** 2 + (j[:, None] - j) ** 2
        covariance = sd**2 * ((1 - NUGGET) * np.exp(-0.5 * apart / REACH**2))
        return np.asarray(np.linalg.inv(covariance + sd**2 * NUGGET * np.eye(self.size)))


def grid_over(rpm: Sequence[FloatArray], load: Sequence[FloatArray], knots: int = KNOTS) -> Grid:
    """Return ``knots`` in each direction over the places that the drives visit."""
    return Grid(_knots(np.concatenate(rpm), knots), _knots(np.concatenate(load), knots))


def _knots(values: FloatArray, number: int) -> FloatArray:
    low, high = np.percentile(np.log(np.maximum(values, 1.0)), EDGES)
    return np.linspace(low, max(high, low + 0.1), number)


def _place(values: FloatArray, knots: FloatArray) -> tuple[IntArray, FloatArray]:
    at = np.clip((values - knots[0]) / (knots[1] - knots[0]), 0.0, len(knots) - 1.0)
    below = np.minimum(at.astype(np.int64), len(knots) - 2)
    return below, np.asarray(at - below)
