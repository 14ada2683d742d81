"""The excess over the operating range, and the stretch of a drive that shows it best."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.types import BoolArray, FloatArray
from training.greybox.fit.comparison import Comparison, Stack, gather
from training.recordings.rows import hold

SPEEDS: Final = ("engine_speed_rpm", "vehicle_speed_km_h")
LOADS: Final = ("air_mass_mg", "manifold_pressure_kpa", "maf_kg_h", "fuel_mass_mg")
CELLS: Final = 10
LEAST_SAMPLES: Final = 30  # in a cell
EXCERPT_S: Final = 40.0


@dataclass(frozen=True, slots=True)
class OperatingMap:
    """Mean squared residual beyond the reference, on a grid of speed and load."""

    speed: str  # canonical names
    load: str
    speed_edges: FloatArray  # (a + 1,)
    load_edges: FloatArray  # (b + 1,)
    excess: FloatArray  # (b, a) phi², NaN where hardly driven
    mean: FloatArray  # (b, a) mean residual, phi


@dataclass(frozen=True, slots=True)
class Excerpt:
    """A part of one recording."""

    recording: str
    t_s: FloatArray  # (n,)
    measured: FloatArray  # (n,) phi
    predicted: FloatArray
    scored: BoolArray


def operating_map(
    recordings: Sequence[Comparison],
    blocks: Stack,
    healthy: tuple[Sequence[Comparison], Stack] | None,
    reference: float,
) -> OperatingMap | None:
    """Return the map; None if no signal of speed or of load moves.

    reference : mean square taken off where healthy recordings have not been
    """
    speed, load = (_first(names, recordings) for names in (SPEEDS, LOADS))
    if speed is None or load is None:
        return None
    x, y = (_column(name, recordings, blocks) for name in (speed, load))
    edges = [_edges(x), _edges(y)]
    count, mean, square = _cells(x, y, blocks.residual, edges)
    known = np.full(count.shape, reference)
    if healthy is not None and all(n in r.signals for r in healthy[0] for n in (speed, load)):
        own = [_column(name, *healthy) for name in (speed, load)]
        n, _, healthy_square = _cells(own[0], own[1], healthy[1].residual, edges)
        known = np.where(n >= LEAST_SAMPLES, healthy_square, reference)
    seen = count >= LEAST_SAMPLES
    return OperatingMap(
        speed=speed,
        load=load,
        speed_edges=edges[0],
        load_edges=edges[1],
        excess=np.where(seen, square - known, np.nan),
        mean=np.where(seen, mean, np.nan),
    )


def _first(names: Sequence[str], recordings: Sequence[Comparison]) -> str | None:
    for name in names:
        if all(name in r.signals for r in recordings) and any(
            float(np.ptp(hold(r.signals[name])[r.scored])) > 0.0 for r in recordings
        ):
            return name
    return None


def _edges(values: FloatArray) -> FloatArray:
    low, high = (float(v) for v in np.percentile(values, [0.5, 99.5]))
    return np.linspace(low, high if high > low else low + 1.0, CELLS + 1)


def _column(name: str, recordings: Sequence[Comparison], blocks: Stack) -> FloatArray:
    return gather([hold(r.signals[name]) for r in recordings], blocks)


def _cells(
    x: FloatArray, y: FloatArray, residual: FloatArray, edges: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return count, mean and mean square of the residual in each cell (b, a)."""
    bins = [edges[1], edges[0]]
    count = np.histogram2d(y, x, bins)[0]
    many = np.maximum(count, 1.0)
    mean = np.histogram2d(y, x, bins, weights=residual)[0] / many
    return count, mean, np.histogram2d(y, x, bins, weights=residual**2)[0] / many


def excerpt(recordings: Sequence[Comparison], explained: Sequence[FloatArray] | None) -> Excerpt:
    """Return the stretch in which the best driver explains most, or with the largest residual.

    explained : (n,) per recording, what the best driver explains of the residual
    """
    best = (-1.0, 0, 0, 0)
    for i, r in enumerate(recordings):
        length = min(round(EXCERPT_S / r.period_s), len(r.residual))
        weight = r.residual**2
        if explained is not None:
            weight = weight - (r.residual - explained[i]) ** 2
        total = np.concatenate([[0.0], np.cumsum(weight)])
        sums = total[length:] - total[:-length]
        at = int(np.argmax(sums))
        best = max(best, (float(sums[at]), i, at, length))
    _, i, at, length = best
    r, rows = recordings[i], slice(at, at + length)
    t_s = np.arange(at, at + length, dtype=np.float64) * r.period_s
    return Excerpt(
        recording=r.name,
        t_s=t_s,
        measured=r.phi_measured[rows],
        predicted=r.phi_predicted[rows],
        scored=r.scored[rows],
    )
