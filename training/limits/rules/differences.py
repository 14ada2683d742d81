"""The distribution of differences between consecutive samples of the measured signal alone.

After Jammoussi and Makki: the extreme values of sets of differences follow a generalised extreme
value distribution. A sensor late or slow in one direction makes its two sides unlike or piles up
differences in the middle, which is looked for first; then a sensor weak or late both ways, which
makes both sides small. No model is needed, so what the engine does is in the score, too.
Sources: Makki, Kumar, Kerns and Jammoussi, US patent 9 074 513, 2015; Jammoussi, Makki, Banker and
Casedy, US patent 9 500 151, 2016. They judge sets collected over minutes; here one window.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.special import gamma

from monitor.base.types import FloatArray
from training.limits.rules.windows import Windows, limit_for

SET = 5  # differences of which the extreme is taken; nine sets in a window of 50 samples
LEVEL, ASYMMETRY, PEAK = range(3)


def extreme_value_fit(extremes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return location, scale and shape of the distribution of maxima, each (n,).

    extremes : (n, n_sets) maxima; location and scale in their unit; shape k as Hosking's, 0 is
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

    measured : (n, n_samples); level is the logarithm of the typical extreme in the output's unit,
    asymmetry the upper against the lower extreme, -1 to 1, peak the logarithm of root mean square
    over mean magnitude: large where most differences are small and few are large (the moment that
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
    """Faulty where the differences are too unlike up and down, too peaked or too small.

    Set on healthy windows; faulty ones are not used.
    """

    centre: FloatArray  # (3,) medians of healthy windows
    scale: FloatArray  # (3,) their spread
    limit: float  # in spreads

    @classmethod
    def fit(cls, healthy: Windows, faulty: Windows | None, false_alarm_rate: float) -> Self:
        """Return the rule set on healthy windows."""
        low, centre, high = np.quantile(statistics(healthy.measured), [0.25, 0.5, 0.75], axis=0)
        rule = cls(centre, np.maximum((high - low) / 1.349, 1e-9), np.inf)
        limit = limit_for(rule.score(healthy), false_alarm_rate)
        return cls(rule.centre, rule.scale, limit)

    def score(self, windows: Windows) -> FloatArray:
        """Return the largest deviation, (n,), in spreads of healthy windows."""
        return np.asarray(self._deviations(windows).max(axis=1))

    def faulty(self, windows: Windows) -> np.ndarray:
        """Return the verdict on each window, (n,) bool."""
        return self.score(windows) >= self.limit

    def pattern(self, windows: Windows) -> list[str]:
        """Return what each window shows, one-sided first; "" where it is not faulty.

        A sensor slow on one side is on its way there most of the time, so that nearly every set
        has an extreme to that side: on a slow rise of lambda, rich to lean, the upper are larger.
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
