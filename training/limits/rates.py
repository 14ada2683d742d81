"""Rates of counts, with confidence bounds."""

from typing import Any

from scipy.special import betaincinv, gammaincinv  # scipy.stats: half a second to import

CONFIDENCE = 0.95
Figures = dict[str, Any]


def rate(events: int, trials: int) -> Figures:
    """Return a rate and its two-sided 95 % bounds (Clopper and Pearson 1934), None without trials.

    >>> [round(rate(99, 100)[k], 3) for k in ("rate", "low", "high")]
    [0.99, 0.946, 1.0]
    """
    counts = {"events": events, "trials": trials}
    if trials == 0:
        return counts | {"rate": None, "low": None, "high": None}
    missed, tail = trials - events, (1.0 - CONFIDENCE) / 2.0
    low = betaincinv(events, missed + 1, tail) if events else 0.0
    high = betaincinv(events + 1, missed, 1.0 - tail) if missed else 1.0
    return counts | {"rate": events / trials, "low": float(low), "high": float(high)}


def in_words(found: Figures) -> str:
    """Return a rate of trials with its bounds in words."""
    low, high = 100 * found["low"], 100 * found["high"]
    return f"{found['events']} of {found['trials']} (95 %: {low:.1f} to {high:.1f} %)"


def per_1000_h(events: int, seconds: float) -> Figures:
    """Return events per 1,000 hours and the upper 95 % bound of the rate of a Poisson process.

    Source: Garwood, Fiducial limits for the Poisson distribution, Biometrika 28, 1936.

    >>> round(per_1000_h(0, 3600.0 * 1000.0)["high"], 3)
    2.996
    """
    hours = seconds / 3600.0
    if hours <= 0.0:
        return {"events": events, "hours": 0.0, "per_1000_h": None, "high": None}
    high = 1000.0 * float(gammaincinv(events + 1, CONFIDENCE)) / hours
    return {"events": events, "hours": hours, "per_1000_h": 1000.0 * events / hours, "high": high}
