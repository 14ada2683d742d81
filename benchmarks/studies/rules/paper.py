"""The rule of the paper as a baseline."""

from dataclasses import dataclass
from typing import Self

from benchmarks.studies.rules.windows import Windows, limit_for
from monitor.base.types import BoolArray
from training.limits.paper_limits import WindowResiduals, paper_limits


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
        of = _residuals(healthy), _residuals(faulty)
        return cls(*paper_limits(*of, lambda scores: limit_for(scores, false_alarm_rate)))

    def faulty(self, windows: Windows) -> BoolArray:
        """Return the verdict on each window, (n,)."""
        return _residuals(windows).failed(self.j_mu, self.j_sigma)


def _residuals(windows: Windows) -> WindowResiduals:
    residual = windows.residual
    return WindowResiduals(residual.mean(axis=1), residual.std(axis=1))
