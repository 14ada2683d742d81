"""Measures of the data check: motion, copies, coverage."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from monitor.base.types import FloatArray
from training.recordings.metrics import correlation

MOVING = 0.001  # least change between two samples that counts as motion, as a share of the span
COPY = 0.999  # correlation above which one signal is a copy of the other
CELLS = 8  # of the histogram, per axis
VISITED_S = 1.0  # least time in a visited cell
VISITED_SHARE = 0.1  # the same for short recordings, as a share of the time under even spread


@dataclass(frozen=True, slots=True)
class Motion:
    """How an input moves."""

    std: float  # unit of the input
    moves: int  # samples that differ from the sample before
    moving: float  # share of samples that differ from the sample before by more than 0.1 % of span


def motion(stretches: Sequence[FloatArray]) -> Motion:
    """Return how an input moves in its unbroken stretches, shapes (n_i,)."""
    values = np.concatenate(stretches)
    low, high = np.percentile(values, [0.5, 99.5])
    span = float(high - low) or float(np.ptp(values))
    steps = np.concatenate([np.abs(np.diff(s)) for s in stretches])
    return Motion(
        std=float(values.std()),
        moves=int((steps > 1e-9 * span).sum()) if span > 0 else 0,
        moving=float((steps > MOVING * span).mean()) if span > 0 and len(steps) else 0.0,
    )


def copy_of(
    u: Sequence[FloatArray], y: Sequence[FloatArray], most: int
) -> tuple[float, float, int]:
    """Return correlation of levels, correlation of changes, and the lag of their best match.

    u, y : unbroken stretches of input and output, shapes (n_i,)
    most : largest lag to try in samples; the lag is positive if ``u`` follows ``y``
    """
    best = (0.0, 0.0, 0)
    for lag in range(-most, most + 1):
        pairs = [_shifted(a, b, lag) for a, b in zip(u, y, strict=True) if len(a) > 2 * most + 2]
        if not pairs:
            break
        level = correlation(*map(np.concatenate, zip(*pairs, strict=True)))
        if abs(level) > abs(best[0]):
            changes = [(np.diff(a), np.diff(b)) for a, b in pairs]
            change = correlation(*map(np.concatenate, zip(*changes, strict=True)))
            best = (level, change, lag)
    return best


def _shifted(u: FloatArray, y: FloatArray, lag: int) -> tuple[FloatArray, FloatArray]:
    return (u[lag:], y[: len(y) - lag]) if lag >= 0 else (u[:lag], y[-lag:])


@dataclass(frozen=True, slots=True)
class Coverage:
    """Coverage of the plane of speed and load by recordings."""

    share: float  # share of visited cells
    fullest: float  # share of the samples in the fullest cell
    speed_edges: FloatArray  # (CELLS + 1,) edges, unit of the speed signal
    load_edges: FloatArray  # (CELLS + 1,) edges, unit of the load signal
    seconds: FloatArray  # (CELLS, CELLS) time in the cells, speed × load


def coverage(speed: FloatArray, load: FloatArray, period_s: float) -> Coverage:
    """Return the coverage by samples of speed and load, both (n,).

    The plane reaches from the 0.5 % to the 99.5 % quantile of both signals.
    """
    across = np.linspace(*_extremes(speed), CELLS + 1)
    up = np.linspace(*_extremes(load), CELLS + 1)
    counts, *_ = np.histogram2d(speed, load, bins=[across, up])
    seconds = counts * period_s
    total = max(float(counts.sum()), 1.0)
    enough_s = min(VISITED_S, VISITED_SHARE * total * period_s / CELLS**2)
    share, fullest = float((seconds >= enough_s).mean()), float(counts.max()) / total
    return Coverage(share, fullest, across, up, seconds)


def _extremes(values: FloatArray) -> tuple[float, float]:
    low, high = (float(q) for q in np.percentile(values, [0.5, 99.5]))
    return (low, high) if high > low else (low - 0.5, low + 0.5)
