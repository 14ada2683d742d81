"""The rule of the paper as a baseline."""

from dataclasses import astuple, dataclass
from typing import Final, Self

import numpy as np

from benchmarks.studies.rules.windows import Windows, limit_for
from monitor.base.types import BoolArray
from monitor.judge.bias import paper_failed

RATIOS: Final = tuple(2.0**power for power in range(-4, 5))  # of both limits, in faulty medians


@dataclass(frozen=True, slots=True)
class PaperRule:
    """A window is faulty if |mean| and standard deviation of its residual both reach their limits.

    Source: Model Based Diagnosis of Oxygen Sensors, section 2.
    """

    j_mu: float  # output's unit
    j_sigma: float

    @classmethod
    def fit(cls, healthy: Windows, faulty: Windows, false_alarm_rate: float) -> Self:
        """Return the pair, of one for each of ``RATIOS``, that misses the fewest faulty windows."""
        good, bad = (np.abs(_residuals(each)) for each in (healthy, faulty))
        rules = []
        for ratio in RATIOS:
            unit = np.maximum(np.median(bad, axis=0), 1e-12) * (ratio, 1.0)
            level = limit_for((good / unit).min(axis=1), false_alarm_rate)
            rules.append(cls(*(level * unit).tolist()))
        return max(rules, key=lambda rule: rule.faulty(faulty).sum())

    def faulty(self, windows: Windows) -> BoolArray:
        """Return the verdict on each window, (n,)."""
        return np.array([paper_failed(*each, *astuple(self)) for each in _residuals(windows)])


def _residuals(windows: Windows) -> list[tuple[float, float]]:
    return [(float(each.mean()), float(each.std())) for each in windows.residual]
