"""A field over speed and load: bilinear between knots, with a smooth Gaussian prior.

The knots follow the drives and not the axes of a table, so that the estimate of a cell does not
depend on how fine the table is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.quantity.value import cells

KNOTS: Final = 5  # in each direction
REACH: Final = 1.2  # knots: length over which the prior holds neighbours together
NUGGET: Final = 0.02  # of the prior's variance, that no neighbour shares
EDGES: Final = (1.0, 99.0)  # percentiles of the samples between which the knots stand


@dataclass(frozen=True, slots=True)
class Grid:
    """Knots over the logarithms of speed and load."""

    speeds: FloatArray  # (n,) log rpm
    loads: FloatArray  # (m,) log of the load

    @property
    def size(self) -> int:
        """Return the number of knots."""
        return len(self.speeds) * len(self.loads)

    def shares(self, rpm: FloatArray, load: FloatArray) -> FloatArray:
        """Return the knots' shares (n, size) at places (n,); beyond the knots they are constant."""
        at = np.log(rpm), np.log(np.maximum(load, 1.0))
        return cells(*at, (self.speeds, self.loads))

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
