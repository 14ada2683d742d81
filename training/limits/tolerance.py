"""Confidence bounds of false-alarm and detection rates, and limits that keep a rate.

A score alarms if ``score >= limit``. The bounds hold for any distribution of the scores. Windows
of one drive resemble each other, so a second bound beside the one for independent windows draws
whole drives.
"""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy import stats

from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray, IntArray

CONFIDENCE = 0.95
RESAMPLES = 2000
SEED = 0


def rate_bounds(events: int, trials: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the two-sided confidence bounds of a rate, by Clopper and Pearson (1934).

    >>> [round(b, 3) for b in rate_bounds(0, 20)]
    [0.0, 0.168]
    """
    tail = (1.0 - confidence) / 2.0
    low = float(stats.beta.ppf(tail, events, trials - events + 1)) if events else 0.0
    return low, upper_bound(events, trials, 1.0 - tail)


def upper_bound(events: int, trials: int, confidence: float = CONFIDENCE) -> float:
    """Return the one-sided upper confidence bound of a rate, by Clopper and Pearson (1934)."""
    if events >= trials:
        return 1.0
    return float(stats.beta.ppf(confidence, events + 1, trials - events))


def quantile_bounds(
    values: Sequence[float] | FloatArray, share: float, confidence: float = CONFIDENCE
) -> tuple[float | None, float | None]:
    """Return the two-sided confidence bounds of a quantile, None beyond the values (n,).

    The bounds are order statistics and hold for any distribution.
    Source: Conover, Practical Nonparametric Statistics, 3rd ed., section 3.2.

    >>> quantile_bounds(np.arange(101.0), 0.5)
    (40.0, 60.0)
    """
    n, x = len(values), np.sort(values)
    tail = (1.0 - confidence) / 2.0
    low, high = (int(stats.binom.ppf(q, n, share)) for q in (tail, 1.0 - tail))
    return float(x[low - 1]) if low else None, float(x[high]) if high < n else None


def windows_needed(rate: float, confidence: float = CONFIDENCE) -> int:
    """Return the smallest number of windows whose largest score is a limit for ``rate``.

    Source: Wilks, Determination of sample sizes for setting tolerance limits, 1941.

    >>> windows_needed(0.05), windows_needed(0.01)
    (59, 299)
    """
    return math.ceil(math.log(1.0 - confidence) / math.log(1.0 - rate))


def most_alarms(trials: int, rate: float, confidence: float = CONFIDENCE) -> int:
    """Return how many healthy windows may alarm while the rate is proved to be at most ``rate``.

    Raises RecordingError if the windows prove no such rate even without an alarm.
    """
    needed = windows_needed(rate, confidence)
    if trials < needed:
        raise RecordingError(
            f"{trials} healthy windows, {needed} are wanted to prove a false-alarm rate of at most "
            f"{rate:g} per window with {100 * confidence:.4g} % confidence: give more or longer "
            "recordings, or a higher --false-alarms"
        )
    bounds = stats.beta.ppf(confidence, np.arange(1, trials + 1), trials - np.arange(trials))
    return int(np.searchsorted(bounds, rate, side="right")) - 1


def cluster_bound(alarms: np.ndarray, drives: IntArray, confidence: float = CONFIDENCE) -> float:
    """Return the upper confidence bound of the alarm rate from drawing whole drives (bootstrap).

    alarms : (n,) bool; drives : (n,) number of each window's drive
    The bound is 0 if no window alarms; use ``upper_bound`` then.
    Source: Davison and Hinkley, Bootstrap Methods and their Application, section 3.8.
    """
    _, index = np.unique(drives, return_inverse=True)
    totals = np.bincount(index)
    counts = np.bincount(index, weights=alarms)
    drawn = _drawn(len(totals))
    return float(np.quantile(drawn @ counts / (drawn @ totals), confidence))


@lru_cache(maxsize=4)
def _drawn(n: int) -> FloatArray:
    """Return how often every resample draws every one of ``n`` drives, (RESAMPLES, n)."""
    drawn = np.random.default_rng(SEED).multinomial(n, np.full(n, 1.0 / n), RESAMPLES)
    return drawn.astype(np.float64)


def just_above(value: float) -> float:
    """Return a limit so far above ``value`` that ``value`` does not reach it after rounding."""
    return value + 1e-9 * max(abs(value), 1e-9)


def tolerance_limit(
    scores: FloatArray, drives: IntArray, rate: float, confidence: float = CONFIDENCE
) -> float:
    """Return the lowest limit whose false-alarm rate is at most ``rate`` by both bounds.

    scores, drives : (n,) score and drive of each healthy window
    The limit lies just above an order statistic, so that ties do not alarm.
    Raises RecordingError if there are too few windows.
    """
    falling = np.sort(scores)[::-1]
    for allowed in range(most_alarms(len(scores), rate, confidence), -1, -1):
        limit = just_above(float(falling[allowed]))
        if cluster_bound(scores >= limit, drives, confidence) <= rate:
            break
    return limit
