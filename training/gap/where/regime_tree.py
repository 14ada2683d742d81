"""Regimes as boxes of the operating range: a small regression tree on the squared residual.

Grown on every other pair of blocks, read on the blocks between, so that a box is not chosen by the
samples that judge it. It sees sizes only; what an excess depends on dynamically, ``regimes`` finds.
Source: Breiman et al., Classification and Regression Trees, 1984; Athey and Imbens, PNAS 113
(2016) for the honest halves.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from monitor.base.types import BoolArray, FloatArray
from training.gap.where.bootstrap import Excess, Share
from training.gap.where.drivers import Driver, find_drivers
from training.greybox.fit.comparison import Comparison, Stack, gather

DEPTH: Final = 3
LEAST_SHARE: Final = 0.03  # of the samples in a box
CUTS: Final = 16  # places tried per variable
WORTH: Final = 0.02  # a split takes at least this share of the squares' variance away
NOT_SPLIT: Final = frozenset({"phi_predicted", "phi_slope_1_s", "inverse_flow_h_kg"})


@dataclass(frozen=True, slots=True)
class Box:
    """A part of the operating range."""

    bounds: dict[str, tuple[float, float]]  # driver → from, to
    words: dict[str, str] = field(repr=False)
    time_share: float  # of the scored samples
    share: Share  # of the excess squared error

    @property
    def sentence(self) -> str:
        """Return the finding in words."""
        limits = [_limit(self.words[n], low, high) for n, (low, high) in self.bounds.items()]
        where = ", ".join(limits) or "all samples"
        return f"{where}: {self.share} of the excess in {self.time_share:.0%} of the time."


def _limit(words: str, low: float, high: float) -> str:
    if np.isinf(low):
        return f"{words} below {high:.4g}"
    return f"{words} above {low:.4g}" if np.isinf(high) else f"{words} {low:.4g} to {high:.4g}"


def find_boxes(
    recordings: Sequence[Comparison],
    blocks: Stack,
    excess: Excess,
    healthy: tuple[Sequence[Comparison], Stack] | None,
) -> tuple[Box, ...]:
    """Return boxes that cover the operating range, the largest share of the excess first."""
    drivers = [d for d in find_drivers(recordings) if d.name not in NOT_SPLIT]
    columns = {d.name: gather(d.values, blocks) for d in drivers}
    squares = blocks.residual**2
    even = (blocks.block // 2) % 2 == 0
    known = None if healthy is None else _healthy_columns(drivers, *healthy)
    found = []
    for bounds in _grow({n: c[even] for n, c in columns.items()}, squares[even], DEPTH):
        rows = _inside(columns, bounds, ~even)
        reference = excess.reference
        if known is not None:
            alike = _inside(known[0], bounds, np.ones(len(known[1]), dtype=np.bool_))
            if alike.sum() > 50:
                reference = float(known[1][alike].mean())
        part = blocks.sums(np.where(rows, squares - reference, 0.0))
        scale = len(even) / max(int((~even).sum()), 1)  # the half stands for the whole
        words = {d.name: d.words for d in drivers}
        found.append(Box(bounds, words, float(rows[~even].mean()), excess.share(scale * part)))
    return tuple(sorted(found, key=lambda box: -box.share.value))


def _healthy_columns(
    drivers: Sequence[Driver], recordings: Sequence[Comparison], blocks: Stack
) -> tuple[dict[str, FloatArray], FloatArray]:
    own = {d.name: gather(d.values, blocks) for d in find_drivers(recordings)}
    constant = np.zeros(len(blocks.residual))
    return {d.name: own.get(d.name, constant) for d in drivers}, blocks.residual**2


def _inside(
    columns: dict[str, FloatArray], bounds: dict[str, tuple[float, float]], rows: BoolArray
) -> BoolArray:
    for name, (low, high) in bounds.items():
        rows = rows & (columns[name] > low) & (columns[name] <= high)
    return rows


def _grow(
    columns: dict[str, FloatArray], target: FloatArray, depth: int
) -> Iterator[dict[str, tuple[float, float]]]:
    """Yield the bounds of the leaves of a tree that takes most squared error away."""
    total = len(target)
    capped = np.minimum(target, np.quantile(target, 0.995))  # one spike makes no regime
    yield from _split(columns, capped, np.arange(total), {}, depth, float(capped.var()) * total)


def _split(
    columns: dict[str, FloatArray],
    target: FloatArray,
    rows: "np.ndarray[tuple[int], np.dtype[np.int64]]",
    bounds: dict[str, tuple[float, float]],
    depth: int,
    whole: float,
) -> Iterator[dict[str, tuple[float, float]]]:
    best = (WORTH * whole, "", 0.0)
    if depth > 0:
        for name, column in columns.items():
            gain, cut = _best_cut(column[rows], target[rows], LEAST_SHARE * len(target))
            best = max(best, (gain, name, cut))
    _, name, cut = best
    if not name:
        yield bounds
        return
    low, high = bounds.get(name, (-np.inf, np.inf))
    below = columns[name][rows] <= cut
    for side, limits in ((below, (low, cut)), (~below, (cut, high))):
        yield from _split(columns, target, rows[side], {**bounds, name: limits}, depth - 1, whole)


def _best_cut(values: FloatArray, target: FloatArray, least: float) -> tuple[float, float]:
    """Return the squared error that the best cut takes away, and the cut."""
    cuts = np.unique(np.quantile(values, np.linspace(0.0, 1.0, CUTS + 2)[1:-1]))
    place = np.searchsorted(cuts, values)  # values at a cut lie below it
    count = np.cumsum(np.bincount(place, minlength=len(cuts) + 1))[:-1].astype(float)
    total = np.cumsum(np.bincount(place, target, len(cuts) + 1))[:-1]
    n, s = float(len(target)), float(target.sum())
    allowed = (count >= least) & (n - count >= least)
    if not allowed.any():
        return 0.0, 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = total**2 / count + (s - total) ** 2 / (n - count) - s**2 / n
    gain = np.where(allowed, gain, -np.inf)
    at = int(np.argmax(gain))
    return float(gain[at]), float(cuts[at])
