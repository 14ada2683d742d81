"""The two limits of the paper's rule: faulty where |mean| >= j_mu and std >= j_sigma.

Source of the rule: Model Based Diagnosis of Oxygen Sensors, section 2.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray, IntArray
from training.limits.tolerance import CONFIDENCE, cluster_bound, tolerance_limit, upper_bound

# Ratios of the two limits, in medians of the faulty windows. They are fixed in advance, so the
# confidence pays for the choice among them (Bonferroni) and for nothing else.
RATIOS = tuple(2.0**power for power in range(-4, 5))


@dataclass(frozen=True, slots=True)
class Residuals:
    """Mean and spread of the residual in windows."""

    mean: FloatArray  # (n,) in the output's unit
    std: FloatArray  # (n,) in the output's unit
    drive: IntArray  # (n,) number of the window's drive

    def failed(self, j_mu: float, j_sigma: float) -> np.ndarray:
        """Return the paper's verdict on each window, (n,) bool."""
        return (np.abs(self.mean) >= j_mu) & (self.std >= j_sigma)

    def of(self, chosen: np.ndarray) -> "Residuals":
        """Return the windows where ``chosen`` (n,) bool is true."""
        return Residuals(self.mean[chosen], self.std[chosen], self.drive[chosen])


@dataclass(frozen=True, slots=True)
class PaperLimits:
    """Both limits, with their false alarms on the calibration drives."""

    j_mu: float  # in the output's unit
    j_sigma: float
    alarms: int  # healthy windows that reach both limits
    windows: int
    confidence: float  # of the bound for independent windows, after paying for the choice
    bound: float  # upper bound of the false-alarm rate, for independent windows
    bound_drives: float  # upper bound from resampling whole drives


def choose(healthy: Residuals, faulty: Residuals | None, rate: float) -> PaperLimits:
    """Return the limits for a false-alarm rate of at most ``rate`` per window.

    Without faulty windows, each limit alone keeps the rate. With them, the result is the pair that
    keeps the rate and misses the fewest faulty windows.
    Raises RecordingError if there are too few healthy windows.
    """
    if faulty is None or len(faulty.mean) == 0:
        j_mu = tolerance_limit(np.abs(healthy.mean), healthy.drive, rate)
        j_sigma = tolerance_limit(healthy.std, healthy.drive, rate)
        return _with_bounds(healthy, j_mu, j_sigma, CONFIDENCE)
    confidence = 1.0 - (1.0 - CONFIDENCE) / len(RATIOS)
    pairs = boundary(healthy, faulty, rate, confidence)
    found = [int(faulty.failed(*pair).sum()) for pair in pairs]
    return _with_bounds(healthy, *pairs[int(np.argmax(found))], confidence)


def held_out(
    healthy: Residuals, faulty: Residuals | None, rate: float
) -> tuple[int | None, int | None]:
    """Return how many healthy and faulty windows fail limits that were set without their drive.

    A number is None if the other drives are too few to set limits.
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
        left_out = residuals.drive == number
        try:
            limits = limits_from(residuals.of(~left_out))
        except RecordingError:
            return None
        failed += int(residuals.of(left_out).failed(limits.j_mu, limits.j_sigma).sum())
    return failed


def boundary(
    healthy: Residuals, faulty: Residuals, rate: float, confidence: float
) -> list[tuple[float, float]]:
    """Return for every ratio of ``RATIOS`` the lowest pair of limits that keeps the rate."""
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
        j_mu,
        j_sigma,
        int(alarms.sum()),
        n,
        confidence,
        upper_bound(int(alarms.sum()), n, confidence),
        cluster_bound(alarms, healthy.drive),
    )
