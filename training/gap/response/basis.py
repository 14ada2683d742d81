"""Smooth functions of one variable."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from monitor.base.types import FloatArray


@dataclass(frozen=True, slots=True)
class Basis:
    """Cubic B-splines between quantiles of a variable; straight lines if it takes few values."""

    knots: FloatArray  # with repeated ends, or the two ends alone

    @classmethod
    def of(cls, values: FloatArray, intervals: int) -> "Basis":
        """Return the basis for a variable of these values (m,), with so many inner intervals."""
        low, high = (float(v) for v in np.percentile(values, [0.5, 99.5]))
        inside = values[(values >= low) & (values <= high)]
        inner = np.unique(np.quantile(inside, np.linspace(0.0, 1.0, intervals + 1)))
        if len(inner) < 4:  # a variable that mostly rests has its quantiles at one value
            inner = np.unique(np.quantile(np.unique(inside), np.linspace(0.0, 1.0, intervals + 1)))
        if len(inner) < 3:
            return cls(np.array([float(values.min()), float(values.max())]))
        return cls(np.concatenate([np.repeat(inner[0], 3), inner, np.repeat(inner[-1], 3)]))

    def __call__(self, values: FloatArray) -> FloatArray:
        """Return the functions at ``values`` (n,), shape (n, k); a constant lies in their span.

        They move within the range of the knots and are constant outside.
        """
        low, high = float(self.knots[0]), float(self.knots[-1])
        x = np.clip(values, low, high)
        if len(self.knots) == 2:
            part = (x - low) / (high - low)
            return np.column_stack([1.0 - part, part])
        return np.asarray(BSpline.design_matrix(x, self.knots, 3).toarray())
