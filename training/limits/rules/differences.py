"""Differences between consecutive samples of the measured signal, judged without a model.

After Jammoussi and Makki: the extremes of sets of differences follow a generalised extreme value
distribution. A sensor that is late or slow in one direction makes the two sides unlike, or piles up
small differences; the rule looks for this first. A sensor that is weak, or late in both directions,
makes both sides small. The engine's operation is in the score, too, because there is no model.
Sources: Makki, Kumar, Kerns and Jammoussi, US patent 9 074 513, 2015; Jammoussi, Makki, Banker and
Casedy, US patent 9 500 151, 2016. They judge sets collected over minutes, this rule a window.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.special import gamma

from monitor.base.types import FloatArray
from training.limits.rules.windows import Windows, limit_for

SET = 5  # differences per set; a window of 50 samples has nine sets
LEVEL, ASYMMETRY, PEAK = range(3)


def extreme_value_fit(extremes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return location, scale and shape of the distribution of maxima, (n,) each.

    extremes : (n, n_sets) maxima; location and scale have their unit; shape is Hosking's k, 0 is
        Gumbel
    Source: Hosking, Wallis and Wood, Estimation of the generalized extreme-value distribution by
    the method of probability-weighted moments, Technometrics 27, 1985.
    """
    x = np.sort(extremes, axis=1)
    m = x.shape[1]
    j = np.arange(m)
    b0 = x.mean(axis=1)
    b1 = x @ (j / (m - 1)) / m
    b2 = x @ (j * (j - 1) / ((m - 1) * (m - 2))) / m
    spread = np.maximum(2.0 * b1 - b0, 1e-12)
    c = spread / np.maximum(3.0 * b2 - b0, 1e-12) - np.log(2.0) / np.log(3.0)
    k = np.clip(7.8590 * c + 2.9554 * c**2, -0.9, 3.0)
    k = np.where(np.abs(k) < 1e-6, 1e-6, k)
    scale = spread * k / (gamma(1.0 + k) * (1.0 - 2.0**-k))
    return b0 + scale * (gamma(1.0 + k) - 1.0) / k, scale, k


def statistics(measured: FloatArray) -> FloatArray:
    """Return level, asymmetry and peak of each window's differences, (n, 3).

    measured : (n, n_samples)
    Level is the logarithm of the typical extreme, in the output's unit. Asymmetry compares the
    upper with the lower extreme, -1 to 1. Peak is the logarithm of root mean square over mean
    magnitude; it is large if most differences are small and a few large (the moment ratio that
    gives a generalised Gaussian its shape: Mallat, IEEE Trans. PAMI 11, 1989).
    """
    d = np.diff(measured, axis=1)
    sets = d[:, : d.shape[1] // SET * SET].reshape(len(d), -1, SET)
    up, *_ = extreme_value_fit(sets.max(axis=2))
    down, *_ = extreme_value_fit(-sets.min(axis=2))
    up, down = np.maximum(up, 1e-9), np.maximum(down, 1e-9)
    magnitude = np.abs(d).mean(axis=1) + 1e-9
    peak = np.log((np.sqrt((d**2).mean(axis=1)) + 1e-9) / magnitude)
    return np.column_stack([np.log(up + down), (up - down) / (up + down), peak])


@dataclass(frozen=True, slots=True)
class DifferencesRule:
    """Faulty if the differences are too asymmetric, too peaked or too small.

    The rule is fitted to healthy windows; faulty windows are not used.
    """

    centre: FloatArray  # (3,) medians of healthy windows
    scale: FloatArray  # (3,) spreads of healthy windows
    limit: float  # in these spreads

    @classmethod
    def fit(cls, healthy: Windows, faulty: Windows | None, false_alarm_rate: float) -> Self:
        """Return the rule fitted to healthy windows."""
        low, centre, high = np.quantile(statistics(healthy.measured), [0.25, 0.5, 0.75], axis=0)
        rule = cls(centre, np.maximum((high - low) / 1.349, 1e-9), np.inf)
        limit = limit_for(rule.score(healthy), false_alarm_rate)
        return cls(rule.centre, rule.scale, limit)

    def score(self, windows: Windows) -> FloatArray:
        """Return each window's largest deviation, (n,), in spreads of healthy windows."""
        return np.asarray(self._deviations(windows).max(axis=1))

    def faulty(self, windows: Windows) -> np.ndarray:
        """Return the verdict on each window, (n,) bool."""
        return self.score(windows) >= self.limit

    def pattern(self, windows: Windows) -> list[str]:
        """Return the pattern of each window: one-sided, "symmetric", or "" if it is not faulty.

        A sensor slow on one side moves that way most of the time, so nearly every set has an
        extreme on that side: with a slow rise of lambda (rich to lean) the upper ones are larger.
        """
        deviations = self._deviations(windows)
        sign = statistics(windows.measured)[:, ASYMMETRY] - self.centre[ASYMMETRY]
        return [
            ""
            if deviation.max() < self.limit
            else "symmetric"
            if deviation[[ASYMMETRY, PEAK]].max() < self.limit
            else "rich_to_lean"
            if s > 0.0
            else "lean_to_rich"
            for deviation, s in zip(deviations, sign, strict=True)
        ]

    def _deviations(self, windows: Windows) -> FloatArray:
        z = (statistics(windows.measured) - self.centre) / self.scale
        return np.column_stack([-z[:, LEVEL], np.abs(z[:, ASYMMETRY]), z[:, PEAK]])
