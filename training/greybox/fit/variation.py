"""How healthy drives differ from each other: random coefficients, one set per drive.

Healthy drives differ by message phases on the bus, weather, and operating points that the
correction has not seen. A disagreement counts by its excess over these differences: the errors of a
new drive are judged with its random coefficients integrated out.
Source: Laird and Ware, Random-effects models for longitudinal data, Biometrics 38 (1982).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monitor.base.types import FloatArray

VALUE_LEAST = 0.02  # of a direction, in sigma squared: a smaller one changes errors by under 1 %


@dataclass(frozen=True, slots=True)
class Shrink:
    """A symmetric root of the precision: I - U diag(share) U', for one drive."""

    directions: NDArray[np.float32]  # (m, q) orthonormal; half the bytes in the loops of a fit
    share: NDArray[np.float32]  # (q,)

    def apply(self, error: FloatArray) -> FloatArray:
        """Return errors, (m,) or (m, k), with the random coefficients integrated out."""
        inner = ((self.directions.T @ error.astype(np.float32)).T * self.share).T
        return np.asarray(error - self.directions @ inner)


def shrink(columns: FloatArray, spread: FloatArray) -> Shrink:
    """Return the root for whitened columns (m, k) whose coefficients have this spread (k,)."""
    scaled = columns * spread
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    used = values > VALUE_LEAST
    directions = scaled @ vectors[:, used] / np.sqrt(values[used])
    share = 1.0 - 1.0 / np.sqrt(1.0 + values[used])
    return Shrink(np.asfortranarray(directions, np.float32), share.astype(np.float32))
