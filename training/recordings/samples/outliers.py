"""Samples that cannot be: outside the plausible range, or spikes of a single sample."""

import numpy as np

from monitor.base.signals import BY_NAME, OUTPUT
from monitor.base.types import FloatArray

SPIKE_SIGMA = 12.0  # a lone sample this many robust deviations off its neighbours is an outlier


def outlier_mask(name: str, values: FloatArray) -> np.ndarray:
    """Return (n,) bool: implausible by the signal's range, or a spike of a single sample.

    A spike differs from both neighbours by more than 12 robust deviations of the sample-to-sample
    change and by more than 98 % of the values span, and the neighbours agree.
    """
    bad = np.isneginf(values) if name == OUTPUT else np.isinf(values)
    signal = BY_NAME.get(name)
    if signal is not None:
        # a lambda above its range is lean air like any other
        high = np.inf if name == OUTPUT else signal.maximum
        bad |= (values < signal.minimum) | (values > high)
    if len(values) < 3:
        return bad
    left, middle, right = values[:-2], values[1:-1], values[2:]
    change = np.abs(np.diff(values))
    sigma = 1.4826 * float(np.nanmedian(change)) if np.isfinite(change).any() else 0.0
    finite = values[np.isfinite(values)]
    if sigma > 0 and len(finite):
        span = float(np.percentile(finite, 99.0) - np.percentile(finite, 1.0))
        limit = max(SPIKE_SIGMA * sigma, span)
        with np.errstate(invalid="ignore"):
            off = np.minimum(np.abs(middle - left), np.abs(middle - right)) > limit
            bad[1:-1] |= off & (np.abs(left - right) < 0.2 * limit)
    return bad
