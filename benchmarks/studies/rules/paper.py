"""The rule of the paper as a baseline."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from benchmarks.studies.rules.windows import Windows, limit_for
from monitor.base.types import FloatArray
from training.limits.paper_limits import RATIOS


@dataclass(frozen=True, slots=True)
class PaperRule:
    """A window is faulty if |mean| and standard deviation of its residual both reach their limits.

    With faulty windows, ``fit`` chooses the pair of limits that keeps the false-alarm rate and
    misses the fewest faulty windows.
    Source: Model Based Diagnosis of Oxygen Sensors, section 2.
    """

    j_mu: float  # output's unit
    j_sigma: float

    @classmethod
    def fit(cls, healthy: Windows, faulty: Windows | None, false_alarm_rate: float) -> Self:
        """Return the rule with both limits; without faulty windows they are healthy quantiles.

        Raises RecordingError if there are too few healthy windows.
        """
        if faulty is None or len(faulty) == 0:
            mean, std = _mean_std(healthy)
            return cls(limit_for(mean, false_alarm_rate), limit_for(std, false_alarm_rate))
        mu, sigma = (max(float(np.median(values)), 1e-12) for values in _mean_std(faulty))
        rules = []
        for ratio in RATIOS:
            rule = cls(mu * ratio, sigma)
            level = limit_for(rule.score(healthy), false_alarm_rate)
            rules.append(cls(level * rule.j_mu, level * rule.j_sigma))
        return max(rules, key=lambda rule: int(rule.faulty(faulty).sum()))

    def score(self, windows: Windows) -> FloatArray:
        """Return the smaller of |mean| / j_mu and std / j_sigma per window, (n,)."""
        mean, std = _mean_std(windows)
        return np.minimum(mean / self.j_mu, std / self.j_sigma)

    def faulty(self, windows: Windows) -> np.ndarray:
        """Return the verdict on each window, (n,) bool."""
        mean, std = _mean_std(windows)
        return (mean >= self.j_mu) & (std >= self.j_sigma)


def _mean_std(windows: Windows) -> tuple[FloatArray, FloatArray]:
    residual = windows.residual
    return np.abs(residual.mean(axis=1)), residual.std(axis=1)
