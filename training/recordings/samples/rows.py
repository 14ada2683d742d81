"""Gaps in the rows of a recording, held."""

import numpy as np

from monitor.base.types import FloatArray


def hold(values: FloatArray) -> FloatArray:
    """Return (n,) with every gap filled by the value before it, the first by the one after.

    >>> hold(np.array([np.nan, 1.0, np.nan, 3.0]))
    array([1., 1., 1., 3.])
    """
    finite = np.isfinite(values)
    if not finite.any():
        return np.zeros_like(values)
    last = np.maximum.accumulate(np.where(finite, np.arange(len(values)), -1))
    return np.asarray(values[np.where(last < 0, int(np.argmax(finite)), last)])
