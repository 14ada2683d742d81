"""Adaptive threshold: the limit of the residual rises with the activity of the inputs.

The model errs more while its inputs move.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.optimize import linprog
from scipy.signal import lfilter

from benchmarks.studies.rules.windows import Windows, limit_for
from monitor.base.types import FloatArray

ACTIVITY_SAMPLES = 5.0  # time constant of the activity filter in samples
QUANTILE = 0.95  # of healthy |residual|; the limit is a line through it over the activity
MOST_SAMPLES = 4000  # of the fit; more samples are thinned evenly


@dataclass(frozen=True, slots=True)
class AdaptiveThreshold:
    """A window is faulty if a |residual| exceeds ``level * (base + slope * activity)``.

    The activity is the filtered change per sample of the predicted output, which stands for the
    inputs. Base and slope are a regression quantile of healthy |residual|. The level keeps the
    false-alarm rate of whole windows. The rule does not use faulty windows.
    Sources: Emami-Naeini, Akhter and Rock, Effect of model uncertainty on failure detection: the
    threshold selector, IEEE Trans. Automatic Control 33, 1988; Koenker and Bassett, Regression
    quantiles, Econometrica 46, 1978.
    """

    base: float  # output's unit
    slope: float  # samples
    level: float  # -

    @classmethod
    def fit(cls, healthy: Windows, faulty: Windows, false_alarm_rate: float) -> Self:
        """Return the rule set on healthy windows."""
        x, r = _activity(healthy.predicted).ravel(), np.abs(healthy.residual).ravel()
        step = max(1, len(x) // MOST_SAMPLES)
        base, slope = _regression_quantile(x[::step], r[::step], QUANTILE)
        base = max(base, 0.1 * float(np.quantile(r, QUANTILE)), 1e-12)
        rule = cls(base, slope, 1.0)
        return cls(base, slope, limit_for(rule.score(healthy), false_alarm_rate))

    def score(self, windows: Windows) -> FloatArray:
        """Return the largest |residual| / ``(base + slope * activity)`` per window, (n,)."""
        line = self.base + self.slope * _activity(windows.predicted)
        return np.asarray((np.abs(windows.residual) / line).max(axis=1))

    def faulty(self, windows: Windows) -> np.ndarray:
        """Return the verdict on each window, (n,) bool."""
        return self.score(windows) >= self.level


def _activity(predicted: FloatArray) -> FloatArray:
    """Return the filtered |change| per sample, (n, n_samples); the filter starts settled."""
    change = np.abs(np.diff(predicted, axis=1))
    change = np.concatenate([change[:, :1], change], axis=1)
    keep = float(np.exp(-1.0 / ACTIVITY_SAMPLES))
    filtered, _ = lfilter([1.0 - keep], [1.0, -keep], change, axis=1, zi=keep * change[:, :1])
    return np.asarray(filtered)


def _regression_quantile(x: FloatArray, y: FloatArray, q: float) -> tuple[float, float]:
    """Return base and slope, both at least 0, of the regression q-quantile of y over x.

    The function solves the dual of Koenker and Bassett's linear programme, which has bounded
    weights and two rows only.
    """
    scale = max(float(x.max()), 1e-12)
    rows = np.stack([np.ones_like(x), x / scale])
    wanted = (1.0 - q) * rows.sum(axis=1)
    solution = linprog(-y, A_ub=rows, b_ub=wanted, bounds=(0.0, 1.0))
    base, slope = -solution.ineqlin.marginals
    return max(float(base), 0.0), max(float(slope), 0.0) / scale
