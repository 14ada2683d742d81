"""Rates of counts and medians of times, with confidence bounds."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import stats

from monitor.base.types import FloatArray
from training.limits.tolerance import CONFIDENCE, rate_bounds

Figures = dict[str, Any]
THINNED = 200  # most points of a ROC curve in a result


def rate(events: int, trials: int) -> Figures:
    """Return a rate and its two-sided 95 % bounds (Clopper and Pearson 1934), None without trials.

    >>> [round(rate(99, 100)[k], 3) for k in ("rate", "low", "high")]
    [0.99, 0.946, 1.0]
    """
    counts = {"events": events, "trials": trials}
    if trials == 0:
        return counts | {"rate": None, "low": None, "high": None}
    low, high = rate_bounds(events, trials)
    return counts | {"rate": events / trials, "low": low, "high": high}


def per_1000_h(events: int, seconds: float) -> Figures:
    """Return events per 1,000 hours and the upper 95 % bound of the rate of a Poisson process.

    Source: Garwood, Fiducial limits for the Poisson distribution, Biometrika 28, 1936.

    >>> round(per_1000_h(0, 3600.0 * 1000.0)["high"], 3)
    2.996
    """
    hours = seconds / 3600.0
    if hours <= 0.0:
        return {"events": events, "hours": 0.0, "per_1000_h": None, "high": None}
    high = float(stats.chi2.ppf(CONFIDENCE, 2 * (events + 1))) / 2.0
    return {
        "events": events,
        "hours": hours,
        "per_1000_h": 1000.0 * events / hours,
        "high": 1000.0 * high / hours,
    }


def median(times_s: Sequence[float | None]) -> Figures:
    """Return the median of times in s and its two-sided 95 % bounds; None means never.

    The bounds are order statistics and hold for any distribution.
    Source: Conover, Practical Nonparametric Statistics, 3rd ed., section 3.2.
    """
    x = np.sort([math.inf if t is None else t for t in times_s])
    n = len(x)
    figures: Figures = {"trials": n, "median": None, "low": None, "high": None}
    if n == 0:
        return figures
    below = int(stats.binom.ppf((1.0 - CONFIDENCE) / 2.0, n, 0.5))
    figures["median"] = _finite(float(x[(n - 1) // 2] + x[n // 2]) / 2.0)
    figures["low"] = _finite(float(x[below - 1])) if below else 0.0
    figures["high"] = _finite(float(x[n - below])) if below else None
    return figures


def roc(healthy: Sequence[float | None], faulty: Sequence[float | None]) -> Figures:
    """Return the receiver operating characteristic of a score over drives.

    healthy, faulty : score of each drive; a drive with the score None alarms at no limit
    ``area`` counts ties as one half. ``at_1_percent`` is the share of faulty drives that alarm when
    at most 1 % of the healthy drives do; ``at_none`` is this share without any false alarm.
    ``points`` are pairs of false-alarm rate and detection rate.
    """
    good, bad = (
        np.array([-math.inf if s is None else s for s in scores]) for scores in (healthy, faulty)
    )
    if not len(good) or not len(bad):
        return {"area": None, "at_none": None, "at_1_percent": None, "points": []}
    limits = np.unique(np.concatenate([good, bad]))[::-1]
    limits = limits[np.isfinite(limits)]
    false = _share_reaching(good, limits)
    true = _share_reaching(bad, limits)
    above = np.array([(good < s).mean() + 0.5 * (good == s).mean() for s in bad])
    at_1 = true[false <= 0.01]
    keep = np.unique(np.linspace(0, len(limits) - 1, min(THINNED, len(limits))).astype(int))
    return {
        "area": float(above.mean()),
        "at_none": float((bad > good.max()).mean()),
        "at_1_percent": float(at_1.max()) if len(at_1) else 0.0,
        "points": [[0.0, 0.0]] + [[float(false[i]), float(true[i])] for i in keep],
    }


def _share_reaching(scores: FloatArray, limits: FloatArray) -> FloatArray:
    ordered = np.sort(scores)
    return np.asarray(1.0 - np.searchsorted(ordered, limits, side="left") / len(scores))


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
