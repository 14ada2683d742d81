"""Rows of a recording: runs of alike rows, and gaps held."""

import numpy as np

from monitor.base.types import FloatArray


def runs(good: np.ndarray) -> list[tuple[int, int]]:
    """Return (first, stop) of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


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
