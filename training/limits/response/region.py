"""The joint region of a model's inputs, learned from the windows of healthy recordings."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from monitor.judge.response.region import Region, counted, points_of
from monitor.pipeline.events import WindowJudged

POINTS: Final = 96  # that are kept
GROUPS: Final = 4  # of fewer recordings, parts in a row are left out in turn
MARGIN: Final = 1.5  # a window may lie so much further off than any left out did
LEAST_WINDOWS: Final = 40  # fewer say little about the region


def region_of(
    drives: Sequence[Sequence[WindowJudged]], names: Sequence[str], ignored: Sequence[str] = ()
) -> Region | None:
    """Return the region of healthy drives' windows, None if they are too few.

    Each drive is left out in turn: no window of it lies further than ``most`` from the others'.
    names : of the inputs
    ignored : inputs that do not count in the distance
    """
    groups = [points_of(np.array([w.window.inputs for w in drive])) for drive in drives if drive]
    if sum(map(len, groups)) < LEAST_WINDOWS:
        return None
    if len(groups) < GROUPS:
        groups = [part for whole in groups for part in np.array_split(whole, GROUPS) if len(part)]
    everything = np.concatenate(groups)
    std = everything.std(axis=0)[: len(names)]  # a mean and a spread of an input have one unit
    scale = np.tile(np.where(std > 0.0, std, 1.0), 2)
    counts = counted(names, ignored)  # the others stand still in every point
    everything = np.where(counts, everything / scale, 0.0)
    groups = [np.where(counts, group / scale, 0.0) for group in groups]
    left_out = max(
        float(apart.max())
        for i, group in enumerate(groups)
        if len(apart := _apart(group, cover(np.concatenate(groups[:i] + groups[i + 1 :]), POINTS)))
    )
    points = cover(everything, POINTS).round(4)
    return Region(tuple(names), scale, points, MARGIN * max(left_out, 1e-6), tuple(ignored))


def cover(points: FloatArray, n: int) -> FloatArray:
    """Return at most n of the points, (m, d): each next one is the furthest from those before.

    >>> cover(np.array([[0.0], [1.0], [9.0], [10.0]]), 2).tolist()
    [[0.0], [10.0]]
    """
    chosen = [0]
    apart = np.square(points - points[0]).sum(axis=1)
    while len(chosen) < n and apart.max() > 0.0:
        chosen.append(int(apart.argmax()))
        apart = np.minimum(apart, np.square(points - points[chosen[-1]]).sum(axis=1))
    return points[chosen]


def _apart(points: FloatArray, kept: FloatArray) -> FloatArray:
    """Return the distance of each point from the nearest kept one, (n,)."""
    return np.asarray(
        np.sqrt([np.square(kept - each).sum(axis=1).min() for each in points]), dtype=np.float64
    )
