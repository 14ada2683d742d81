"""Rule of Jammoussi and Makki: the distribution of differences between successive samples.

The extreme values of sets of differences follow a generalised extreme value distribution. A sensor
that is late or slow in one direction makes the two sides of the distribution unlike or piles up
differences in its middle; the rule looks for this first. A sensor that is weak or late in both
directions makes both sides small. The rule needs no model, so the driving also moves its score.
Sources: Makki, Kumar, Kerns and Jammoussi, US patent 9 074 513, 2015; Jammoussi, Makki, Banker and
Casedy, US patent 9 500 151, 2016. The patents judge sets collected over minutes; this rule judges
single windows.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.special import gamma

from benchmarks.studies.rules.windows import Windows, limit_for
from monitor.base.types import FloatArray

SET = 5  # differences per extreme value; a window of 50 samples has nine sets
LEVEL, ASYMMETRY, PEAK = range(3)


def extreme_value_fit(extremes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return location, scale and shape of the distribution of maxima, three arrays (n,).

    extremes : (n, n_sets) maxima
    Location and scale have the unit of the maxima. The shape k has Hosking's sign; 0 is Gumbel.
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
    """Return level, asymmetry and peak of the differences in each window, (n, 3).

    measured : (n, n_samples) output's unit
    Level is the logarithm of the typical extreme. Asymmetry compares the upper with the lower
    extreme, -1 to 1. Peak is the logarithm of root mean square over mean magnitude; it is large if
    most differences are small and few are large.
    Source of the peak: the shape of a generalised Gaussian, Mallat, IEEE Trans. PAMI 11, 1989.
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
    """A window is faulty if its differences are too asymmetric, too peaked or too small.

    The rule uses healthy windows only.
    """

    centre: FloatArray  # (3,) medians of healthy statistics
    scale: FloatArray  # (3,) robust standard deviations of healthy statistics
    limit: float  # in robust standard deviations

    @classmethod
    def fit(cls, healthy: Windows, faulty: Windows, false_alarm_rate: float) -> Self:
        """Return the rule set on healthy windows."""
        low, centre, high = np.quantile(statistics(healthy.measured), [0.25, 0.5, 0.75], axis=0)
        rule = cls(centre, np.maximum((high - low) / 1.349, 1e-9), np.inf)
        limit = limit_for(rule.score(healthy), false_alarm_rate)
        return cls(rule.centre, rule.scale, limit)

    def score(self, windows: Windows) -> FloatArray:
        """Return the largest deviation per window, (n,), in healthy standard deviations."""
        z = (statistics(windows.measured) - self.centre) / self.scale
        sides = [-z[:, LEVEL], np.abs(z[:, ASYMMETRY]), z[:, PEAK]]
        return np.asarray(np.max(sides, axis=0))

    def faulty(self, windows: Windows) -> np.ndarray:
        """Return the verdict on each window, (n,) bool."""
        return self.score(windows) >= self.limit
