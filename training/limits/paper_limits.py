"""The two limits of the paper's rule: a window is faulty if |mean| >= j_mu and std >= j_sigma.

Source of the rule: Model Based Diagnosis of Oxygen Sensors, section 2.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray, IntArray
from training.limits.tolerance import CONFIDENCE, cluster_bound, tolerance_limit, upper_bound

# Ratios of j_mu to j_sigma that ``choose`` tries, both in medians of the faulty windows. The ratios
# are fixed in advance, so the confidence only pays for choosing among nine (Bonferroni).
RATIOS = tuple(2.0**power for power in range(-4, 5))


@dataclass(frozen=True, slots=True)
class Residuals:
    """Mean and standard deviation of the residual in each window."""

    mean: FloatArray  # (n,) output's unit
    std: FloatArray  # (n,) output's unit
    drive: IntArray  # (n,) number of the window's drive

    def failed(self, j_mu: float, j_sigma: float) -> np.ndarray:
        """Return the verdict of the paper's rule on each window, (n,) bool, True is faulty."""
        return (np.abs(self.mean) >= j_mu) & (self.std >= j_sigma)

    def of(self, chosen: np.ndarray) -> "Residuals":
        """Return the windows with ``chosen``, (n,) bool, True."""
        return Residuals(self.mean[chosen], self.std[chosen], self.drive[chosen])


@dataclass(frozen=True, slots=True)
class PaperLimits:
    """Both limits of the paper's rule with their false alarms on the healthy windows."""

    j_mu: float  # output's unit
    j_sigma: float
    alarms: int  # healthy windows that reach both limits
    windows: int  # healthy windows
    confidence: float  # of ``bound``, higher than 0.95 if the limits were chosen among several
    bound: float  # upper bound of the false-alarm rate for independent windows
    bound_drives: float  # upper bound of the false-alarm rate from drawing whole drives


def choose(healthy: Residuals, faulty: Residuals | None, rate: float) -> PaperLimits:
    """Return the limits for a false-alarm rate of at most ``rate`` per window.

    Without faulty windows, each limit alone keeps the rate. With faulty windows, the pair of limits
    keeps the rate and misses the fewest faulty windows.
    Raises RecordingError if there are too few healthy windows.
    """
    if faulty is None or len(faulty.mean) == 0:
        j_mu = tolerance_limit(np.abs(healthy.mean), healthy.drive, rate)
        j_sigma = tolerance_limit(healthy.std, healthy.drive, rate)
        return _with_bounds(healthy, j_mu, j_sigma, CONFIDENCE)
    confidence = 1.0 - (1.0 - CONFIDENCE) / len(RATIOS)
    pairs = boundary(healthy, faulty, rate, confidence)
    detected = [int(faulty.failed(*pair).sum()) for pair in pairs]
    return _with_bounds(healthy, *pairs[int(np.argmax(detected))], confidence)


def held_out(
    healthy: Residuals, faulty: Residuals | None, rate: float
) -> tuple[int | None, int | None]:
    """Return how many healthy and how many faulty windows fail limits set without their drive.

    A number is None if the remaining drives do not suffice to set limits.
    """
    alarms = _failed_by_others(healthy, lambda others: choose(others, faulty, rate))
    if faulty is None:
        return alarms, None
    return alarms, _failed_by_others(faulty, lambda others: choose(healthy, others, rate))


def _failed_by_others(
    residuals: Residuals, limits_from: Callable[[Residuals], PaperLimits]
) -> int | None:
    numbers = np.unique(residuals.drive)
    if len(numbers) < 2:
        return None
    failed = 0
    for number in numbers:
        inside = residuals.drive == number
        try:
            limits = limits_from(residuals.of(~inside))
        except RecordingError:
            return None
        failed += int(residuals.of(inside).failed(limits.j_mu, limits.j_sigma).sum())
    return failed


def boundary(
    healthy: Residuals, faulty: Residuals, rate: float, confidence: float
) -> list[tuple[float, float]]:
    """Return one pair of limits (j_mu, j_sigma) per ratio in ``RATIOS``; every pair keeps the rate.

    Raises RecordingError if there are too few healthy windows.
    """
    mu = max(float(np.median(np.abs(faulty.mean))), 1e-12)
    sigma = max(float(np.median(faulty.std)), 1e-12)
    pairs = []
    for ratio in RATIOS:
        scores = np.minimum(np.abs(healthy.mean) / (mu * ratio), healthy.std / sigma)
        level = tolerance_limit(scores, healthy.drive, rate, confidence)
        pairs.append((level * mu * ratio, level * sigma))
    return pairs


def _with_bounds(healthy: Residuals, j_mu: float, j_sigma: float, confidence: float) -> PaperLimits:
    alarms = healthy.failed(j_mu, j_sigma)
    n = len(alarms)
    return PaperLimits(
        j_mu=j_mu,
        j_sigma=j_sigma,
        alarms=int(alarms.sum()),
        windows=n,
        confidence=confidence,
        bound=upper_bound(int(alarms.sum()), n, confidence),
        bound_drives=cluster_bound(alarms, healthy.drive),
    )
