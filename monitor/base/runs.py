"""Counts and runs of consecutive samples over a whole recording, vectorised."""

import numpy as np

from monitor.base.types import BoolArray, IntArray


def since(broken: BoolArray, start: int = 0) -> IntArray:
    """Return at each sample the number of samples since the last broken one, shape (n,).

    start : the count before the first sample

    >>> since(np.array([False, True, False, False]), 5).tolist()
    [6, 0, 1, 2]
    """
    places = np.arange(len(broken))
    return places - np.maximum.accumulate(np.where(broken, places, -1 - start))


def stretches(on: BoolArray, n: int) -> IntArray:
    """Cut each run of true samples into stretches of ``n``; return where the whole ones begin.

    >>> stretches(np.array([True, True, True, True, True, False, True, True]), 2).tolist()
    [0, 2, 6]
    """
    count = since(~on)
    return np.flatnonzero((count > 0) & (count % n == 0)) - (n - 1)


def runs(on: BoolArray) -> list[tuple[int, int]]:
    """Return (begin, end) of each run of true samples; end is exclusive.

    >>> runs(np.array([True, True, False, True]))
    [(0, 2), (3, 4)]
    """
    steps = np.diff(on.astype(np.int8), prepend=0, append=0)
    begins, ends = np.flatnonzero(steps == 1).tolist(), np.flatnonzero(steps == -1).tolist()
    return list(zip(begins, ends, strict=True))
