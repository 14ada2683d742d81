"""Normal equations of one family in blocks of time, and what they say about each run.

The relation that healthy runs have with the columns is taken away first, every healthy run's by the
others. The fit of the new runs is held against each run: for a new one it comes from the other new
runs. A run's *slope* is the part of the fit that its error has, 1 where it has all of it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.types import FloatArray, IntArray
from training.gap.response.families import Family
from training.gap.response.reference import NOTHING, Spread, solve
from training.greybox.fit.drive import BLOCK_S, Comparison, block_numbers
from training.healthy.behaviour import noise, white

TINY: Final = 1e-100
LEAST: Final = 1e-9  # of the runs' mean power, at which a run's slope is unknown


@dataclass(frozen=True, slots=True)
class EquationBlocks:
    """The samples of all runs that whitening can reach, in blocks of time, and how it is done."""

    rows: tuple[IntArray, ...]  # of each run, see ``ChainDrive.kept``
    number: IntArray  # (m,) block of each row, through all runs
    run: IntArray  # (n_blocks,)
    spread: tuple[FloatArray, ...]  # (n,) of each run's errors
    ar: tuple[float, float]  # autoregression of the healthy errors, newest first

    @classmethod
    def of(
        cls, new: Sequence[Comparison], healthy: Sequence[Comparison], size: Spread
    ) -> "EquationBlocks":
        """Return blocks as long as the other statistics use."""
        runs = (*new, *healthy)
        spread = tuple(size(r) for r in runs)
        rows = tuple(np.flatnonzero(r.kept) for r in runs)
        number = block_numbers(rows, round(BLOCK_S / runs[0].period_s))
        run = np.repeat(np.arange(len(runs)), [len(own) for own in rows])
        known = zip(healthy, spread[len(new) :], strict=True)
        errors = np.concatenate([(r.residual / each)[r.scored] for r, each in known])
        ar, _ = noise([r.scored for r in healthy], errors)
        return cls(rows, number, run[np.unique(number, return_index=True)[1]], spread, ar)

    def white(self, values: Sequence[FloatArray]) -> FloatArray:
        """Return the rows (m, …) of every run's values (n, …) over the spread, whitened."""
        of = zip(values, self.spread, self.rows, strict=True)
        return np.concatenate([white((x.T / s).T, self.ar)[rows] for x, s, rows in of])

    def means(self, values: Sequence[FloatArray]) -> FloatArray:
        """Return the mean (n_blocks,) of every run's values (n,)."""
        x = np.concatenate([x[rows] for x, rows in zip(values, self.rows, strict=True)])
        return np.bincount(self.number, x) / np.bincount(self.number)


@dataclass(frozen=True, slots=True)
class Equations:
    """Sums of one family over every block of every run."""

    gram: FloatArray  # (n_blocks, k, k)
    right: FloatArray  # (n_blocks, k)
    run: IntArray  # (n_blocks,)

    @classmethod
    def of(cls, family: Family, error: FloatArray, blocks: EquationBlocks) -> "Equations":
        """Return the sums for the runs' whitened errors (m,)."""
        edges = np.searchsorted(blocks.number, np.arange(1, len(blocks.run)))
        parts = np.split(blocks.white(family.columns), edges)
        errors = np.split(error, edges)
        return cls(
            np.array([x.T @ x for x in parts]),
            np.array([x.T @ e for x, e in zip(parts, errors, strict=True)]),
            blocks.run,
        )


@dataclass(frozen=True, slots=True)
class Held:
    """A family's fit of the new runs against every run."""

    cross: FloatArray  # (n_blocks,) error times fit
    power: FloatArray  # (n_blocks,) fit squared
    new: IntArray  # runs
    healthy: IntArray
    run: IntArray  # (n_blocks,)
    coefficients: FloatArray  # (k,) of all new runs, beyond healthy ones

    @property
    def gain(self) -> float:
        """Return the fall of the new runs' sum of squares by fits that did not see them."""
        own = np.isin(self.run, self.new)
        return float((2.0 * self.cross - self.power)[own].sum())

    def slopes(self) -> tuple[FloatArray, FloatArray]:
        """Return each run's slope, new ones first, and its variance from block to block.

        A run that moves the fit little has a slope that is little known. How much blocks differ
        for their power is the same in all runs: one run may have the power in a single block.
        """
        runs = np.concatenate([self.new, self.healthy])
        own = (self.run == runs[:, np.newaxis]).astype(np.float64)  # (n_runs, n_blocks)
        power = own @ self.power
        if power.mean() < NOTHING:
            return np.zeros(len(runs)), np.ones(len(runs))
        power = np.maximum(power, LEAST * power.mean())
        slope = own @ self.cross / power
        rest = (self.cross - slope @ own * self.power)[own.any(axis=0)]
        return slope, rest @ rest / power.sum() / power

    @property
    def t(self) -> float:
        """Return t of the new runs' slopes above those of the healthy ones.

        Each pair of new runs counts twice, once as fit and once as run, so the mean of the new
        slopes has twice the variance of a mean of independent ones.
        """
        (slope, within), n = self.slopes(), len(self.new)
        return two_sided(slope[:n], within[:n], slope[n:], within[n:], times=2.0)


def hold(equations: Equations, new: IntArray, healthy: IntArray) -> Held:
    """Return the fit of the new runs held against each, beyond the relation of healthy runs."""
    e = equations
    own = {int(r): np.flatnonzero(e.run == r) for r in (*new, *healthy)}
    gram = {r: e.gram[rows].sum(0) for r, rows in own.items()}
    right = {r: e.right[rows].sum(0) for r, rows in own.items()}
    known, fresh = healthy.tolist(), new.tolist()
    rest = {}
    for r, rows in own.items():
        others = [h for h in known if h != r]
        usual = solve(_sum(gram, others), _sum(right, others))
        rest[r] = e.right[rows] - e.gram[rows] @ usual
    right = {r: sums.sum(0) for r, sums in rest.items()}
    whole = solve(_sum(gram, fresh), _sum(right, fresh))
    cross, power = np.zeros(len(e.run)), np.zeros(len(e.run))
    for r, rows in own.items():
        if r not in fresh:
            parts = [(slice(None), whole)]
        elif len(fresh) > 1:
            others = [n for n in fresh if n != r]
            parts = [(slice(None), solve(_sum(gram, others), _sum(right, others)))]
        else:  # one half of a run by the other
            half = len(rows) // 2
            first, last = slice(None, half), slice(half, None)
            parts = [
                (part, solve(e.gram[rows[other]].sum(0), rest[r][other].sum(0)))
                for part, other in ((first, last), (last, first))
            ]
        for part, fit in parts:
            cross[rows[part]] = rest[r][part] @ fit
            power[rows[part]] = np.einsum("i,bij,j->b", fit, e.gram[rows[part]], fit)
    return Held(cross, power, new, healthy, e.run, whole)


def _sum(sums: Mapping[int, FloatArray], runs: Sequence[int]) -> FloatArray:
    return np.asarray(np.sum([sums[r] for r in runs], axis=0))


def two_sided(
    new: FloatArray,
    within_new: FloatArray,
    healthy: FloatArray,
    within_healthy: FloatArray,
    *,
    times: float = 1.0,
) -> float:
    """Return t of the difference of two groups of runs.

    A run weighs by its variance from block to block and the variance from run to run beyond that.
    The spread is never less than blocks within runs alone would give: few runs may be alike by
    chance. Source: DerSimonian and Laird, Controlled Clinical Trials 7 (1986).

    times : of the variance of the new runs' mean, where their values are not independent
    """
    groups = ((new, np.maximum(within_new, TINY)), (healthy, np.maximum(within_healthy, TINY)))
    squares = spread = 0.0
    for values, within in groups:
        weight = 1.0 / within
        squares += float(weight @ (values - weight @ values / weight.sum()) ** 2)
        spread += float(weight.sum() - weight @ weight / weight.sum())
    between = max((squares - (len(new) + len(healthy) - 2)) / max(spread, TINY), 0.0)
    weights = [1.0 / (within + between) for _, within in groups]
    here, there = (float(w @ v / w.sum()) for w, (v, _) in zip(weights, groups, strict=True))
    variance = times / weights[0].sum() + 1.0 / weights[1].sum()
    return (here - there) / float(np.sqrt(variance))
