"""Scores on held-out blocks: gain in deviance, its t, adequacy against a ceiling, wins."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from monitor.base.types import FloatArray, IntArray
from training.greybox.fit import ridge
from training.greybox.fit.case import Case, plain_errors, predict
from training.greybox.fit.drive import FOLDS
from training.greybox.fit.joint import JointFit, held_out
from training.healthy.behaviour import columns, common, noise, white

LARGEST: Final = 5.0  # of a whitened error in sigma, beyond which it counts no more
BOOTSTRAPS: Final = 2000
MOVED_LEAST: Final = 4.0  # sum of squares of a block
BLOCKS_LEAST: Final = 6
# Of the ceiling. Where it knows nothing, the last ones leave hardly any of it.
PENALTIES: Final = (*ridge.PENALTIES, 0.1, 1.0, 10.0)


@dataclass(frozen=True, slots=True)
class Score:
    """How much better a model explains held-out blocks than another."""

    gain: float  # fall of the deviance
    t: float  # of the signed square roots of the blocks' gains


def deviance(found: JointFit, blocks: IntArray) -> FloatArray:
    """Return the held-out deviance of every block, (n_blocks,)."""
    return by_block(held_out(found, blocks), blocks)


def moved(before: JointFit, after: JointFit, blocks: IntArray) -> FloatArray:
    """Return how far two predictions differ in every block, (n_blocks,)."""
    change = (after.residual - before.residual) ** 2
    return np.asarray(np.bincount(blocks, change), dtype=np.float64)


def by_block(error: FloatArray, blocks: IntArray) -> FloatArray:
    """Return the sum of bounded squares per block."""
    squares = np.minimum(np.abs(error), LARGEST) ** 2
    return np.asarray(np.bincount(blocks, squares), dtype=np.float64)


def score(before: FloatArray, after: FloatArray, moved: FloatArray | None = None) -> Score:
    """Return the score of deviances per block (n_blocks,).

    moved : (n_blocks,) how far the two predictions differ, a sum of squares in sigma; blocks in
        which they agree say nothing and do not count for t
    """
    gains = before - after
    used = gains if moved is None else gains[moved > MOVED_LEAST]
    if len(used) < BLOCKS_LEAST:
        return Score(float(gains.sum()), 0.0)
    roots = np.sign(used) * np.sqrt(np.abs(used))
    spread = float(roots.std(ddof=1))
    t = float(roots.mean()) / max(spread, 1e-12) * np.sqrt(len(roots))
    return Score(float(gains.sum()), float(t))


def draws(n: int, seed: int = 5) -> FloatArray:
    """Return how often each of n blocks stands in each resample, (n_draws, n).

    Source: Efron and Tibshirani, An Introduction to the Bootstrap, 1993, chapter 8.
    """
    rng = np.random.default_rng(seed)
    return rng.multinomial(n, np.full(n, 1.0 / n), BOOTSTRAPS).astype(np.float64)


def win(better: FloatArray, other: FloatArray) -> float:
    """Return how often resampled blocks prefer the first of two deviances (n_blocks,)."""
    return float((draws(len(better)) @ (other - better) > 0.0).mean())


def plain_columns(case: Case, found: JointFit) -> list[FloatArray]:
    """Return the functions, (n, k) per drive."""
    return common([columns(drive, found.base) for drive in case.drives])[1]


def ceiling(case: Case, plain: Sequence[FloatArray]) -> FloatArray:
    """Return the columns (m, k) of everything that could be explained, whitened as the case's
    errors are, in sigma.
    """
    whitened = [white(x, case.ar)[rows] for x, rows in zip(plain, case.rows, strict=True)]
    if case.shrinks:
        whitened = [shrink.apply(x) for shrink, x in zip(case.shrinks, whitened, strict=True)]
    return np.asarray(np.concatenate(whitened) / case.sigma)


def explained(found: JointFit, roof: FloatArray, blocks: IntArray) -> FloatArray:
    """Return by how much the deviance of every held-out block falls with the ceiling."""
    rest = left_by(roof, found.jacobian, found.residual, blocks)
    return by_block(found.residual, blocks) - by_block(rest, blocks)


def left_by(
    roof: FloatArray, known: FloatArray, errors: FloatArray, blocks: IntArray
) -> FloatArray:
    """Return what the ceiling leaves of held-out errors (m,) in sigma.

    known : (m, p) further columns, what constants that were fitted may move
    It is as free as bounded errors want it, because bounded errors are what counts.
    """
    table = np.column_stack([roof, known])
    own = ridge.fit(table, errors, blocks % FOLDS, penalties=PENALTIES, largest=LARGEST)
    return errors - own.held_out


def whitened(case: Case, found: JointFit, plain: Sequence[FloatArray]) -> Case:
    """Return the case with AR(2) and sigma of the noise, from the ceiling's residual in phi."""
    ar, sigma = noise([d.kept for d in case.drives], _plain_rest(case, found, plain))
    return replace(case, ar=ar, sigma=sigma)


def as_they_are(case: Case, found: JointFit) -> Case:
    """Return the case with errors that are not whitened: slow ones count as fast ones."""
    return replace(case, ar=(0.0, 0.0), sigma=floor_phi(case, found), shrinks=())


def floor_phi(case: Case, found: JointFit) -> float:
    """Return the RMSE in phi that the ceiling leaves on held-out blocks."""
    rest = _plain_rest(case, found, plain_columns(case, found))
    return float(np.sqrt(np.mean(rest**2)))


def _plain_rest(case: Case, found: JointFit, plain: Sequence[FloatArray]) -> FloatArray:
    flat = replace(case, ar=(0.0, 0.0), sigma=1.0, shrinks=())
    e = plain_errors(case, predict(case, found.base, found.terms, found.parameters))
    return e - ridge.fit(ceiling(flat, plain), e, flat.blocks % FOLDS).held_out
