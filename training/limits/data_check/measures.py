"""Measures of the data check: excitation, copies, collinearity, coverage."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from monitor.base.types import FloatArray
from training.recordings.spectrum import welch

MOVING = 0.001  # least change between two samples that counts as motion, as a share of the span
PE_CONDITION = 1e10  # power ratio; weaker directions (1e5 in size) drown in 16-bit rounding
COPY = 0.999  # correlation above which one signal is a copy of the other
CONDITION_INDEX = 30.0  # above it coefficients are degraded (Belsley, Kuh and Welsch)
PROPORTION = 0.5  # share of a coefficient's variance above which it belongs to a direction
CELLS = 8  # of the histogram, per axis
VISITED_S = 1.0  # least time in a visited cell
VISITED_SHARE = 0.1  # the same for short recordings, as a share of the time under even spread
BANDWIDTH = 0.95  # share of the variance below the bandwidth


@dataclass(frozen=True, slots=True)
class Excitation:
    """Excitation of a model by one input."""

    std: float  # unit of the input
    moves: int  # samples that differ from the sample before
    moving: float  # share of samples that differ from the sample before by more than 0.1 % of span
    order: int  # of persistent excitation, at most the tested order
    bandwidth_hz: float | None  # 95 % of the variance lies below it; None if too short


def excitation(stretches: Sequence[FloatArray], period_s: float, order: int) -> Excitation:
    """Return the excitation of a model with ``order`` lags by one input.

    stretches : unbroken stretches of the input, shapes (n_i,)
    The order of persistent excitation is the largest L for which the L × L autocovariance matrix
    is not singular; the matrix is the Hankel matrix of the samples times its transpose.
    Source: Ljung, System Identification, 2nd ed., section 13.2.
    """
    values = np.concatenate(stretches)
    low, high = np.percentile(values, [0.5, 99.5])
    span = float(high - low) or float(np.ptp(values))
    steps = np.concatenate([np.abs(np.diff(s)) for s in stretches])
    spectrum = welch([s[:, np.newaxis] for s in stretches], period_s)
    return Excitation(
        std=float(values.std()),
        moves=int((steps > 1e-9 * span).sum()) if span > 0 else 0,
        moving=float((steps > MOVING * span).mean()) if span > 0 and len(steps) else 0.0,
        order=_order(stretches, float(values.mean()), order),
        bandwidth_hz=None
        if spectrum is None
        else _bandwidth(spectrum.frequency_hz, spectrum.density[:, 0]),
    )


def _order(stretches: Sequence[FloatArray], mean: float, most: int) -> int:
    covariance = np.zeros((most, most))
    for values in stretches:
        if len(values) >= most:
            hankel = np.lib.stride_tricks.sliding_window_view(values - mean, most)
            covariance += hankel.T @ hankel
    for order in range(most, 0, -1):
        powers = linalg.eigvalsh(covariance[:order, :order])
        if powers[-1] > 0.0 and powers[0] > powers[-1] / PE_CONDITION:
            return order
    return 0


def _bandwidth(frequency_hz: FloatArray, density: FloatArray) -> float:
    power = np.cumsum(density)
    return float(frequency_hz[np.searchsorted(power, BANDWIDTH * power[-1])])


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
        level = _correlation(*map(np.concatenate, zip(*pairs, strict=True)))
        if abs(level) > abs(best[0]):
            changes = [(np.diff(a), np.diff(b)) for a, b in pairs]
            change = _correlation(*map(np.concatenate, zip(*changes, strict=True)))
            best = (level, change, lag)
    return best


def _shifted(u: FloatArray, y: FloatArray, lag: int) -> tuple[FloatArray, FloatArray]:
    return (u[lag:], y[: len(y) - lag]) if lag >= 0 else (u[:lag], y[-lag:])


def _correlation(a: FloatArray, b: FloatArray) -> float:
    a, b = a - a.mean(), b - b.mean()
    scale = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.clip(a @ b / scale, -1.0, 1.0)) if scale > 0 else 0.0


def collinear(u: FloatArray, names: Sequence[str]) -> tuple[float, list[list[str]]]:
    """Return the condition number of the inputs (n, k), and groups of collinear inputs.

    A group belongs to one direction with a condition index above 30. Its inputs are the inputs
    whose coefficients have more than half of their variance in this direction, at least two.
    Source: Belsley, Kuh and Welsch, Regression Diagnostics (1980), chapter 3.
    """
    z = (u - u.mean(axis=0)) / u.std(axis=0)
    _, sizes, directions = linalg.svd(z, full_matrices=False)
    sizes = np.maximum(sizes, sizes[0] * 1e-15)
    parts = (directions / sizes[:, np.newaxis]) ** 2  # (direction, coefficient)
    parts = parts / parts.sum(axis=0)
    groups = []
    for index, part in zip(sizes[0] / sizes, parts, strict=True):
        members = [n for n, p in zip(names, part, strict=True) if p > PROPORTION]
        if index > CONDITION_INDEX and len(members) > 1:
            groups.append(members)
    return float(sizes[0] / sizes[-1]), groups


def variance_inflation(u: FloatArray) -> FloatArray:
    """Return the variance inflation factor of each column of ``u`` (n, k): 1 / (1 - R²)."""
    z = (u - u.mean(axis=0)) / u.std(axis=0)
    factors = np.empty(z.shape[1])
    for i in range(z.shape[1]):
        others = np.delete(z, i, axis=1)
        rest = z[:, i]
        if others.shape[1]:
            rest = rest - others @ linalg.lstsq(others, rest)[0]
        factors[i] = 1.0 / max(float(rest @ rest) / len(z), 1e-12)
    return factors


@dataclass(frozen=True, slots=True)
class Coverage:
    """Coverage of the plane of speed and load by recordings."""

    share: float  # share of visited cells
    fullest: float  # share of the samples in the fullest cell
    speed: FloatArray  # (CELLS + 1,) edges, unit of the speed signal
    load: FloatArray  # (CELLS + 1,) edges, unit of the load signal
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
