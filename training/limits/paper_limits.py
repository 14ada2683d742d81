"""The two limits of the paper's rule, from windows of healthy and of faulty drives."""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from monitor.judge.bias import paper_failed

RATIOS: Final = tuple(2.0**power for power in range(-4, 5))  # of both limits, in faulty medians
Residuals = Sequence[tuple[float, float]]  # mean and standard deviation of the residual by window


def paper_limits(
    healthy: Residuals, faulty: Residuals, limit_for: Callable[[FloatArray], float]
) -> tuple[float, float]:
    """Return the limits that miss the fewest faulty windows, of one pair for each of ``RATIOS``.

    limit_for : the limit of healthy windows' scores, (n,), for the false-alarm rate wanted
    """
    mu, sigma = np.maximum(np.median(np.abs(faulty), axis=0), 1e-12).tolist()
    mean, std = np.abs(healthy).T
    pairs = []
    for ratio in RATIOS:
        level = limit_for(np.minimum(mean / (mu * ratio), std / sigma))
        pairs.append((level * mu * ratio, level * sigma))
    return max(pairs, key=lambda pair: sum(paper_failed(*each, *pair) for each in faulty))
