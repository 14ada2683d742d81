"""The capacity of the catalyst and its interval, from the evidence of the bank's members.

The capacities of the bank are a third apart, and the evidence of one drive is often narrower than
that. So the log likelihood between them is a smooth curve: cubic Hermite pieces over the logarithm
of the capacity, with slopes by finite differences (Fritsch and Carlson, SIAM J. Numerical Analysis
17, 1980, section 2, without their limit on slopes).

The interval has three parts: the width of that curve; the spread between the drive's stretches
(the jackknife, Efron and Tibshirani, An Introduction to the Bootstrap, chapter 11), since errors
of the predicted voltage repeat within a stretch; and an error of the model that every stretch
shares.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.types import FloatArray

TAIL_90: Final = 1.645  # standard deviations to either end of a 90 % interval
POINTS: Final = 12  # of the curve for each capacity of the bank, even in the logarithm
BOUND: Final = 0.05  # weight of the largest capacity from which the estimate is a lower bound


@dataclass(frozen=True, slots=True)
class Capacity:
    """The capacity of the catalyst, with a 90 % interval."""

    grams: float
    low_g: float
    high_g: float
    is_bound: bool  # nothing showed the upper end: at least ``low_g``


class CapacityCurve:
    """Interpolates log likelihoods between the capacities of the bank.

    log_g : (n,) logarithms of the capacities, rising
    """

    def __init__(self, log_g: FloatArray) -> None:
        steps = np.diff(log_g)
        self.log_g = log_g
        self.points = np.linspace(log_g[0], log_g[-1], POINTS * len(steps) + 1)
        at = np.clip(np.searchsorted(log_g, self.points, side="right") - 1, 0, len(steps) - 1)
        u = (self.points - log_g[at]) / steps[at]
        rising = u * u * (3.0 - 2.0 * u)
        tangents = steps[at] * u * (1.0 - u) ** 2, -steps[at] * u * u * (1.0 - u)
        values = np.eye(len(log_g))
        slopes = np.gradient(values, log_g, axis=0)
        self._curve = (1.0 - rising)[:, np.newaxis] * values[at]  # (n_points, n)
        self._curve += rising[:, np.newaxis] * values[at + 1]
        self._curve += tangents[0][:, np.newaxis] * slopes[at]
        self._curve += tangents[1][:, np.newaxis] * slopes[at + 1]

    def weights(self, log_likelihood: FloatArray) -> FloatArray:
        """Return how likely each point is, from the log likelihood at each capacity, (..., n)."""
        curve = log_likelihood @ self._curve.T
        weights = np.exp(curve - curve.max(axis=-1, keepdims=True))
        return np.asarray(weights / weights.sum(axis=-1, keepdims=True))

    def estimate(self, log_likelihood: FloatArray, without: FloatArray, shared: float) -> Capacity:
        """Return the capacity with its interval.

        log_likelihood : (n,) at each capacity; without : (n_parts, n) without each part
        shared : relative error of the model that all parts share
        """
        weights = self.weights(log_likelihood)
        middle = float(weights @ self.points)
        low, high = np.interp([0.05, 0.95], np.cumsum(weights), self.points).tolist()
        spread = jackknife(self.weights(without) @ self.points)
        other = TAIL_90 * math.hypot(spread, shared)
        low = middle - math.hypot(max(middle - low, 0.0), other)
        high = middle + math.hypot(max(high - middle, 0.0), other)
        grid = np.exp(log_likelihood - log_likelihood.max())
        is_bound = bool(grid[-1] > BOUND * grid.sum())
        return Capacity(math.exp(middle), math.exp(low), math.exp(high), is_bound)


def jackknife(without: FloatArray) -> float:
    """Return the standard error of an estimate from the estimates without each part, (n_parts,).

    >>> jackknife(np.array([1.0, 1.0, 1.0]))
    0.0
    """
    n = len(without)
    return math.sqrt((n - 1) / n * float(((without - without.mean()) ** 2).sum()))
