"""The two limits of the paper's rule: a window is faulty if |mean| >= j_mu and std >= j_sigma.

Source of the rule: Model Based Diagnosis of Oxygen Sensors, section 2.
"""

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from monitor.base.types import BoolArray, FloatArray

RATIOS: Final = tuple(2.0**power for power in range(-4, 5))  # of both limits, in faulty medians


class WindowResiduals(NamedTuple):
    """Mean and standard deviation of the residual in each window, (n,) in the output's unit."""

    mean: FloatArray
    std: FloatArray

    def failed(self, j_mu: float, j_sigma: float) -> BoolArray:
        """Return which windows reach both limits, (n,)."""
        return (np.abs(self.mean) >= j_mu) & (self.std >= j_sigma)


def paper_limits(
    healthy: WindowResiduals, faulty: WindowResiduals, limit_for: Callable[[FloatArray], float]
) -> tuple[float, float]:
    """Return the limits that miss the fewest faulty windows, of one pair for each of ``RATIOS``.

    limit_for : the limit of healthy windows' scores, (n,), for the false-alarm rate wanted
    """
    mu, sigma = (max(float(np.median(np.abs(x))), 1e-12) for x in faulty)
    pairs = []
    for ratio in RATIOS:
        level = limit_for(np.minimum(np.abs(healthy.mean) / (mu * ratio), healthy.std / sigma))
        pairs.append((level * mu * ratio, level * sigma))
    return max(pairs, key=lambda pair: int(faulty.failed(*pair).sum()))
