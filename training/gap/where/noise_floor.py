"""The noise floor of a residual: the part that no model of the present inputs could predict.

Two estimates. What is left of the third differences is noise that is white; it misses noise that
mixing and sensor have smoothed, so it is the least the floor can be. Pairs of samples at nearly
the same operating point, far apart in time, differ by all that does not repeat; this is the most
it can be, since two points are never quite the same.
Source: von Neumann, Annals of Mathematical Statistics 12 (1941); Pi and Peterson, Neural
Computation 6 (1994) for the pairs.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from monitor.base.types import FloatArray
from training.gap.config import CONFIG
from training.gap.where.bootstrap import draw_counts
from training.gap.where.drivers import find_drivers
from training.greybox.fit.comparison import Comparison, Stack, gather
from training.recordings.rows import hold

WEIGHTS: Final = (1.0, -3.0, 3.0, -1.0)  # third difference
LIMITS: Final = CONFIG.noise_floor
MOST_SAMPLES: Final = 20_000
NEIGHBOURS: Final = 12
LEAF: Final = 32  # points of a leaf of the tree; the fastest of 8, 16 and 32
EARLIER_S: Final = (0.0, 0.5, 1.0)
POINT: Final = (
    "air_mass_mg",
    "fuel_mass_mg",
    "engine_speed_rpm",
    "manifold_pressure_kpa",
    "rail_pressure_mpa",
    "coolant_temperature_degc",
    "purge_duty_percent",
)


@dataclass(frozen=True, slots=True)
class NoiseFloor:
    """Standard deviation of the noise in phi with its 90 % bounds, and how it was obtained."""

    rms: float
    low: float
    high: float
    white_rms: float  # from third differences, the least
    sentence: str


def noise_floor(
    recordings: Sequence[Comparison], blocks: Stack, rng: np.random.Generator
) -> NoiseFloor:
    """Return the noise floor of the recordings' residuals.

    ``rms`` is that of repeated operating points where there are enough pairs, because noise is
    smoothed by mixing and sensor, and the white part alone would count it as a gap.
    """
    white, white_draws = _white(recordings, blocks, rng)
    squares = _repeated(recordings, blocks, rng)
    value = float(np.sqrt(squares.mean())) if len(squares) >= LIMITS.pairs_min else None
    if value is None or value <= white:
        low, high = (float(v) for v in np.percentile(white_draws, [5, 95]))
        why = "too few operating points repeat to tell" if value is None else "there is hardly any"
        text = (
            f"Noise floor {white:.4f} ({low:.4f} to {high:.4f}) in phi, from the third differences "
            f"of the residual: the white part of the noise alone; of its smooth part, {why}."
        )
        return NoiseFloor(rms=white, low=low, high=high, white_rms=white, sentence=text)
    draws = np.sqrt([rng.choice(squares, len(squares)).mean() for _ in range(200)])
    low, high = (float(v) for v in np.percentile(draws, [5, 95]))
    text = (
        f"Noise floor {value:.4f} ({low:.4f} to {high:.4f}) in phi, from {len(squares)} pairs of "
        f"samples at nearly the same operating point at least {LIMITS.apart_s:g} s apart: an upper "
        f"bound, because an effect of something that no signal shows does not repeat either. The "
        f"white part of it, from third differences of the residual, is {white:.4f}."
    )
    return NoiseFloor(rms=value, low=low, high=high, white_rms=white, sentence=text)


def _white(
    recordings: Sequence[Comparison], blocks: Stack, rng: np.random.Generator
) -> tuple[float, FloatArray]:
    """Return the white noise's standard deviation and draws of it."""
    squares, whole = [], []
    for r in recordings:
        n = len(r.residual)
        difference, complete = np.zeros(n), np.zeros(n)
        if n > 3:
            parts = [w * r.residual[i : n - 3 + i] for i, w in enumerate(WEIGHTS)]
            difference[3:] = np.sum(parts, axis=0)
            complete[3:] = np.all([r.scored[i : n - 3 + i] for i in range(4)], axis=0)
        squares.append(difference**2 * complete / sum(w**2 for w in WEIGHTS))
        whole.append(complete)
    sums, counts = blocks.sums(gather(squares, blocks)), blocks.sums(gather(whole, blocks))
    drawn = draw_counts(blocks.n_blocks, rng)
    least = np.finfo(float).tiny
    value = float(np.sqrt(sums.sum() / max(counts.sum(), 1.0)))
    return value, np.sqrt((drawn @ sums) / np.maximum(drawn @ counts, least))


def _repeated(
    recordings: Sequence[Comparison], blocks: Stack, rng: np.random.Generator
) -> FloatArray:
    """Return half the squared differences of the closest pairs."""
    points, time_s = _points(recordings, blocks)
    if not points.size:
        return np.zeros(0)
    chosen = np.arange(len(points))
    if len(chosen) > MOST_SAMPLES:
        chosen = np.sort(rng.choice(len(points), MOST_SAMPLES, replace=False))
    near = points[chosen]
    k = min(NEIGHBOURS + 1, len(near))
    # Turned to its principal axes the cloud keeps its distances, and the tree splits along the
    # few of them in which the points differ: three times as fast.
    turned = near @ np.linalg.eigh(near.T @ near)[1]
    found = cKDTree(turned, leafsize=LEAF).query(turned, k=k)
    distance, other = np.asarray(found[0]), np.asarray(found[1])
    apart = np.abs(time_s[chosen][other] - time_s[chosen][:, np.newaxis]) >= LIMITS.apart_s
    first = np.argmax(apart, axis=1)
    rows = np.flatnonzero(apart.any(axis=1))
    far = distance[rows, first[rows]]
    rows = rows[np.argsort(far)[: int(LIMITS.closest_share * len(far))]]
    residual = blocks.residual[chosen]
    return np.asarray((residual[rows] - residual[other[rows, first[rows]]]) ** 2 / 2.0)


def _points(recordings: Sequence[Comparison], blocks: Stack) -> tuple[FloatArray, FloatArray]:
    """Return the operating points (m, k) in standard deviations, now and a little earlier."""
    drivers = {d.name: d.values for d in find_drivers(recordings) if d.name in POINT}
    drivers["phi_predicted"] = tuple(hold(r.phi_predicted) for r in recordings)
    columns = []
    for values in drivers.values():
        for earlier_s in EARLIER_S:
            late = [
                _held(v, round(earlier_s / r.period_s))
                for v, r in zip(values, recordings, strict=True)
            ]
            column = gather(late, blocks)
            columns.append((column - column.mean()) / max(float(column.std()), 1e-12))
    start_s = 0.0
    times_s: list[FloatArray] = []
    for r in recordings:
        times_s.append(start_s + np.arange(len(r.residual), dtype=np.float64) * r.period_s)
        start_s += len(r.residual) * r.period_s + LIMITS.apart_s
    return np.column_stack(columns), gather(times_s, blocks)


def _held(values: FloatArray, samples: int) -> FloatArray:
    return np.concatenate([np.full(min(samples, len(values)), values[0]), values])[: len(values)]
