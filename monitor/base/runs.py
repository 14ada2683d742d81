"""Running counts and runs of alike samples in blocks, with counts carried from block to block."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monitor.base.types import BoolArray, IntArray


def since(broken: BoolArray, start: int | IntArray = 0) -> IntArray:
    """Return after each sample how many have passed since the last broken one, as ``broken``.

    broken : (n,) or (n, m), columns apart from each other
    start : the count before the first sample, for all columns or (m,)

    >>> since(np.array([False, True, False, False]), 5).tolist()
    [6, 0, 1, 2]
    """
    places = np.arange(len(broken))
    if broken.ndim == 2:
        places = places[:, np.newaxis]
    return places - np.maximum.accumulate(np.where(broken, places, -1 - np.asarray(start)), axis=0)


def runs(on: BoolArray) -> list[tuple[int, int]]:
    """Return (begin, end) of each run of true samples; end is exclusive.

    >>> runs(np.array([True, True, False, True]))
    [(0, 2), (3, 4)]
    """
    return [(begin, end) for begin, end, is_on in alike(on) if is_on]


def alike(codes: NDArray[Any]) -> Iterator[tuple[int, int, int]]:
    """Yield (begin, end, code) of each run of samples with the same code.

    >>> list(alike(np.array([7, 7, 3])))
    [(0, 2, 7), (2, 3, 3)]
    """
    if not len(codes):
        return
    edges = [0, *((codes[1:] != codes[:-1]).nonzero()[0] + 1).tolist(), len(codes)]
    for (begin, end), code in zip(pairwise(edges), codes[edges[:-1]].tolist(), strict=True):
        yield begin, end, code
