"""The rule of the paper as a baseline."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from benchmarks.studies.rules.windows import Windows, limit_for
from monitor.base.types import FloatArray

RATIOS: Final = tuple(2.0**power for power in range(-4, 5))  # of the limits, in faulty medians


@dataclass(frozen=True, slots=True)
class PaperRule:
    """A window is faulty if |mean| and standard deviation of its residual both reach their limits.

    ``fit`` chooses the pair of limits that keeps the false-alarm rate and misses the fewest faulty
    windows.
    Source: Model Based Diagnosis of Oxygen Sensors, section 2.
    """

    j_mu: float  # output's unit
    j_sigma: float

    @classmethod
    def fit(cls, healthy: Windows, faulty: Windows, false_alarm_rate: float) -> Self:
        """Return the rule with both limits."""
        mean, std = _mean_std(healthy)
        mu, sigma = (max(float(np.median(values)), 1e-12) for values in _mean_std(faulty))
        rules = []
        for ratio in RATIOS:
            level = limit_for(np.minimum(mean / (mu * ratio), std / sigma), false_alarm_rate)
            rules.append(cls(level * mu * ratio, level * sigma))
        return max(rules, key=lambda rule: int(rule.faulty(faulty).sum()))

    def faulty(self, windows: Windows) -> np.ndarray:
        """Return the verdict on each window, (n,) bool."""
        mean, std = _mean_std(windows)
        return (mean >= self.j_mu) & (std >= self.j_sigma)


def _mean_std(windows: Windows) -> tuple[FloatArray, FloatArray]:
    residual = windows.residual
    return np.abs(residual.mean(axis=1)), residual.std(axis=1)
