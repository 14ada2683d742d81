"""The rule of the paper as a baseline."""

from dataclasses import astuple, dataclass
from typing import Self

import numpy as np

from benchmarks.studies.rules.windows import Windows, limit_for
from monitor.base.types import BoolArray
from monitor.judge.bias import paper_failed
from training.limits.paper_limits import paper_limits


@dataclass(frozen=True, slots=True)
class PaperRule:
    """A window is faulty if |mean| and standard deviation of its residual both reach their limits.

    Source: Model Based Diagnosis of Oxygen Sensors, section 2.
    """

    j_mu: float  # output's unit
    j_sigma: float

    @classmethod
    def fit(cls, healthy: Windows, faulty: Windows, false_alarm_rate: float) -> Self:
        """Return the rule that keeps the rate and misses the fewest faulty windows."""
        of = _residuals(healthy), _residuals(faulty)
        return cls(*paper_limits(*of, lambda scores: limit_for(scores, false_alarm_rate)))

    def faulty(self, windows: Windows) -> BoolArray:
        """Return the verdict on each window, (n,)."""
        return np.array([paper_failed(*each, *astuple(self)) for each in _residuals(windows)])


def _residuals(windows: Windows) -> list[tuple[float, float]]:
    return [(float(each.mean()), float(each.std())) for each in windows.residual]
