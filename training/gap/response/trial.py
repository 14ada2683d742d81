"""The same questions of every set of runs: families, movement, an offset that begins with a run.

The null is what the same questions answer for healthy runs that take the part of new ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb
from typing import Final

import numpy as np
from scipy.special import ndtr, ndtri, stdtr

from monitor.base.types import FloatArray, IntArray
from training.gap.response.equations import EquationBlocks, Equations, Held, hold, two_sided
from training.gap.response.families import Family
from training.gap.response.reference import Spread
from training.greybox.fit.drive import Comparison
from training.greybox.quantity.dynamics import lag

SETS: Final = 60  # of healthy runs that take the part of new ones
PART: Final = 3  # one healthy run in so many does, at most
MOVEMENT_S: Final = 3.0  # over which the reading moves; a slower change is a level
FLOOR: Final = 0.3  # spreads, below which a movement counts as this
LOG_HALF: Final = float(np.log(0.5))


@dataclass(frozen=True, slots=True)
class Trial:
    """The answers for one set of new and healthy runs, as standard normal values."""

    held: tuple[Held, ...]  # of each family
    z: FloatArray  # (n_families,)
    z_swing: float  # of the logarithm of how much the reading moves
    z_begin: float  # of an offset that begins with a run
    begins: int  # the new run, 0 for the first

    @property
    def largest(self) -> float:
        """Return the largest of all."""
        return max(float(self.z.max(initial=0.0)), abs(self.z_swing), abs(self.z_begin))


@dataclass(frozen=True, slots=True)
class Questions:
    """All runs with the sums that every set of them needs."""

    equations: tuple[Equations, ...]
    level: FloatArray  # (n_blocks,) mean error
    swing: FloatArray  # (n_blocks,) mean logarithm of movement over that of a healthy vehicle
    run: IntArray  # (n_blocks,)
    n_new: int

    @classmethod
    def of(
        cls,
        new: Sequence[Comparison],
        healthy: Sequence[Comparison],
        families: Sequence[Family],
        spread: Spread,
    ) -> "Questions":
        """Return the questions for runs beside the healthy vehicle's reading."""
        runs = [*new, *healthy]
        blocks = EquationBlocks.of(new, healthy, spread)
        error = blocks.white([r.residual for r in runs])
        return cls(
            equations=tuple(Equations.of(f, error, blocks) for f in families),
            level=blocks.means([r.residual / s for r, s in zip(runs, blocks.spread, strict=True)]),
            swing=blocks.means(list(map(swing, runs, blocks.spread))),
            run=blocks.run,
            n_new=len(new),
        )

    def ask(self, new: IntArray, healthy: IntArray) -> Trial:
        """Return the answers with these runs as new and healthy ones."""
        held = tuple(hold(e, new, healthy) for e in self.equations)
        freedom = len(new) + len(healthy) - 2
        begins = [
            (self._apart(self.level, new[k:], np.r_[healthy, new[:k]]), k)
            for k in range(1, len(new))
        ]
        z_begin, at = max(begins, key=lambda b: abs(b[0]), default=(0.0, 0))
        return Trial(
            held=held,
            z=np.array([as_normal(h.t, freedom) for h in held]),
            z_swing=self._apart(self.swing, new, healthy),
            z_begin=z_begin,
            begins=at,
        )

    def answer(self) -> Trial:
        """Return the answers for the new runs."""
        runs = np.unique(self.run)
        return self.ask(runs[: self.n_new], runs[self.n_new :])

    def chance(self, rng: np.random.Generator) -> FloatArray:
        """Return the largest answer of sets of healthy runs, (n_sets,)."""
        healthy = np.unique(self.run)[self.n_new :]
        n = max(min(self.n_new, len(healthy) // PART), 1)
        if comb(len(healthy), n) <= SETS:
            sets = [np.array(s) for s in combinations(healthy.tolist(), n)]
        else:
            sets = [np.sort(rng.permutation(healthy)[:n]) for _ in range(SETS)]
        return np.array([self.ask(s, np.setdiff1d(healthy, s)).largest for s in sets])

    def _apart(self, values: FloatArray, new: IntArray, healthy: IntArray) -> float:
        """Return z of the mean of block values between groups of runs."""
        groups = []
        for runs in (new, healthy):
            own = [values[self.run == r] for r in runs]
            groups += [np.array([x.mean() for x in own]), np.array([x.var() / len(x) for x in own])]
        return as_normal(two_sided(*groups), len(new) + len(healthy) - 2)


def swing(run: Comparison, spread: FloatArray) -> FloatArray:
    """Return the logarithm (n,) of how much a reading moves over how much a healthy one would.

    A gain shows in it also where the reading follows the healthy one badly.

    spread : (n,) of the healthy error, which moves the reading too
    """
    moves, healthy = (
        x - lag(x, MOVEMENT_S, run.period_s) for x in (run.phi_measured, run.phi_predicted)
    )
    return np.asarray(np.log(np.hypot(moves, FLOOR * spread)) - np.log(np.hypot(healthy, spread)))


def as_normal(t: float, freedom: int) -> float:
    """Return the standard normal value that is as unlikely as Student's t.

    >>> round(as_normal(2.228, 10), 2)
    1.96
    """
    return float(np.sign(t) * -ndtri(stdtr(max(freedom, 1), -abs(t))))


def p_value(z: float, chance: FloatArray) -> float:
    """Return the chance of as large an answer among all that were asked.

    chance : the largest answers of healthy sets; their median tells how many independent
        questions the answers amount to

    >>> chance = np.array([1.9, 2.0, 2.1])
    >>> round(p_value(2.0, chance), 3), round(p_value(4.0, chance), 4)
    (0.5, 0.001)
    """
    n_questions = max(LOG_HALF / np.log1p(-ndtr(-float(np.median(chance)))), 1.0)
    return float(-np.expm1(n_questions * np.log1p(-ndtr(-z))))
