"""Errors of two models side by side in regimes of the drives, with bounds of their difference.

A regime's blocks of time are a sample of clusters; the bounds of regimes hold for all of them
together. Source: Cochran, Sampling Techniques, 3rd ed., 1977, section 6.4 (ratio estimates).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import stdtrit

from monitor.base.types import BoolArray, FloatArray, IntArray
from training.gap.config import CONFIG
from training.gap.response.drivers import after_fuel_cut, phi_slope
from training.gap.verify.evidence import Error
from training.greybox.fit.drive import BLOCK_S, Comparison, block_numbers

LIMITS: Final = CONFIG.verify
PARTS: Final = 3  # of speed and of load, alike in samples


@dataclass(frozen=True, slots=True)
class Regime:
    """A part of the scored samples."""

    kind: str
    words: str
    rows: BoolArray  # (m,) of the scored samples of all drives, one after the other


def scored(recordings: Sequence[Comparison], arrays: Sequence[FloatArray]) -> FloatArray:
    """Return the scored samples (m,) of one array (n,) per recording."""
    return np.concatenate([a[r.scored] for r, a in zip(recordings, arrays, strict=True)])


def find(recordings: Sequence[Comparison]) -> list[Regime]:
    """Return speed by load, cold and warm, after fuel cut, and edges: where the signals exist."""
    regimes = _speed_and_load(recordings)
    if all("coolant_temperature_degc" in r.signals for r in recordings):
        coolant = scored(recordings, [r.signals["coolant_temperature_degc"] for r in recordings])
        cold = coolant < LIMITS.cold_degc
        regimes += [
            Regime("temperature", f"coolant below {LIMITS.cold_degc:g} °C", cold),
            Regime("temperature", f"coolant above {LIMITS.cold_degc:g} °C", ~cold),
        ]
    since = [s for r in recordings if (s := after_fuel_cut(r)) is not None]
    recent = scored(recordings, since) < LIMITS.after_cut_s
    regimes.append(
        Regime("after fuel cut", f"within {LIMITS.after_cut_s:g} s after a fuel cut", recent)
    )
    return regimes + _edges(recordings)


def _speed_and_load(recordings: Sequence[Comparison]) -> list[Regime]:
    speed, load = (
        scored(recordings, [r.signals[name] for r in recordings])
        for name in ("engine_speed_rpm", "air_mass_mg")
    )
    at = [np.quantile(x, np.linspace(0.0, 1.0, PARTS + 1)) for x in (speed, load)]
    of = [np.searchsorted(edges[1:-1], x) for x, edges in zip((speed, load), at, strict=True)]
    return [
        Regime(
            "speed and load",
            f"{_between(at[0], i, 'rpm')}, {_between(at[1], j, 'mg')}",
            np.asarray((of[0] == i) & (of[1] == j)),
        )
        for i in range(PARTS)
        for j in range(PARTS)
    ]


def _between(edges: FloatArray, i: int, unit: str) -> str:
    return f"{edges[i]:.0f}–{edges[i + 1]:.0f} {unit}"


def _edges(recordings: Sequence[Comparison]) -> list[Regime]:
    """Return edges of the old model's phi: the same samples for both models."""
    slope = scored(recordings, list(map(phi_slope, recordings)))
    steep = float(np.sqrt(np.mean(slope**2)))
    return [
        Regime("edge", "from lean to rich", slope > steep),
        Regime("edge", "from rich to lean", slope < -steep),
        Regime("edge", "no steep edge", np.abs(slope) <= steep),
    ]


def compare(
    recordings: Sequence[Comparison], after: Sequence[FloatArray] | None, floor: FloatArray | None
) -> tuple[Error, ...]:
    """Return the errors of all samples, then those of every regime with enough samples.

    recordings : with the old model's residuals
    after : residuals (n,) of the new model, per recording
    floor : (m,) what is left of the scored samples by a flexible model
    """
    everything = np.ones(sum(int(r.scored.sum()) for r in recordings), dtype=bool)
    regimes = [Regime("all", "all scored samples", everything), *find(recordings)]
    regimes = [r for r in regimes if int(r.rows.sum()) >= LIMITS.samples_min]
    old = scored(recordings, [r.residual for r in recordings])
    new = None if after is None else scored(recordings, after)
    blocks = blocks_of(recordings)
    counts = _sums(regimes, blocks, np.ones(len(old)))
    used = (counts > 0.0).sum(axis=1)
    told, bounds = used >= LIMITS.blocks_min, np.zeros((len(regimes), 2))
    if new is not None:
        pair = (_sums(regimes, blocks, old**2), _sums(regimes, blocks, new**2))
        bounds = _bounds(*pair, counts, told)
    found = []
    for i, regime in enumerate(regimes):
        low, high = bounds[i].tolist() if told[i] and new is not None else (None, None)
        rows, n = regime.rows, int(regime.rows.sum())
        found.append(
            Error(
                kind=regime.kind,
                regime=regime.words,
                samples=n,
                blocks=int(used[i]),
                before=rms(old[rows]),
                after=None if new is None else rms(new[rows]),
                floor=None if floor is None else rms(floor[rows]),
                change_low=low,
                change_high=high,
            )
        )
    return tuple(found)


def rms(values: FloatArray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def blocks_of(recordings: Sequence[Comparison]) -> IntArray:
    """Return the block of each scored sample, (m,), numbered through all recordings."""
    rows = [np.flatnonzero(r.scored) for r in recordings]
    return block_numbers(rows, round(BLOCK_S / recordings[0].period_s))


def _sums(regimes: Sequence[Regime], blocks: IntArray, values: FloatArray) -> FloatArray:
    """Return the sum of ``values`` (m,) over each block in each regime, (n_regimes, n_blocks)."""
    n = int(blocks.max()) + 1
    return np.array([np.bincount(blocks, values * r.rows, n) for r in regimes])


def _bounds(
    before: FloatArray, after: FloatArray, counts: FloatArray, told: BoolArray
) -> FloatArray:
    """Return low and high (n_regimes, 2) of the change of RMSE, Student's t over blocks.

    The first is of all samples and stands by itself; those of the others hold for all ``told``
    together (Bonferroni).
    """
    n = counts.sum(axis=1)
    blocks = np.maximum(n**2 / (counts**2).sum(axis=1), 2.0)  # alike in size that say as much
    change, rest = np.zeros(len(n)), np.zeros_like(counts)
    for sign, sums in ((-1.0, before), (1.0, after)):
        root = np.maximum(np.sqrt(sums.sum(axis=1) / n), np.finfo(float).tiny)
        change += sign * root
        rest += (sign * (sums.T - root**2 * counts.T) / (2.0 * root * n)).T
    spread = np.sqrt((rest**2).sum(axis=1) * blocks / (blocks - 1))
    share = np.where(np.arange(len(n)) == 0, 1.0, 1.0 / max(int(told[1:].sum()), 1))
    reach = stdtrit(blocks - 1, 1.0 - 0.5 * share * (1.0 - LIMITS.confidence)) * spread
    return np.column_stack([change - reach, change + reach])
