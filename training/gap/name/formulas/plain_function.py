"""The plain function of a drive that an error is most like: is there a gap of any kind?"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.types import FloatArray, IntArray
from training.gap.name.formulas.signal_functions import columns, functions_of
from training.greybox.chain import Constants, simulate
from training.greybox.fit.comparison import FOLDS
from training.greybox.fit.drive import ChainDrive, path_of
from training.healthy import scoring
from training.healthy.base_state import BaseState
from training.healthy.features import features

CLEAR_GAIN: Final = 400.0  # fall of the held-out deviance, above what healthy drives give
CLEAR_T: Final = 4.0  # of the signed square roots of the blocks' falls
ANSWERS: Final = ("trim",)  # what the controller makes of the mixture, no cause
OWN_LEAST: Final = 0.02  # of a function's sum of squares that the base's constants do not have


@dataclass(frozen=True, slots=True)
class Plain:
    """The plain function most like the errors, and its gain."""

    score: scoring.Score
    deviance: FloatArray  # (n_blocks,) with it, held-out


def plainest(state: BaseState) -> Plain | None:
    """Return the best plain function, None if it is not clear."""
    table = _table(state)
    known, target, blocks = state.current.jacobian, -state.current.residual, state.case.blocks
    best = _most_alike(table, known, target)
    before = _held_out(known, target, blocks)
    after = _held_out(np.column_stack([known, table[:, best]]), target, blocks)
    moved = np.bincount(blocks, (after - before) ** 2).astype(np.float64)
    left = scoring.by_block(after, blocks)
    score = scoring.score(scoring.by_block(before, blocks), left, moved)
    return Plain(score, left) if score.gain >= CLEAR_GAIN and score.t >= CLEAR_T else None


def _table(state: BaseState) -> FloatArray:
    """Return the values (m, k) of the functions that all drives have, as errors are."""
    drives, base = state.case.drives, state.current.base
    made = [_features(drive, base) for drive in drives]
    shared = [n for n in made[0] if n not in ANSWERS and all(n in each for each in made)]
    own = functions_of(drives)
    tables = [
        np.column_stack([*(each[n] for n in shared), columns(drive, base, own)])
        for drive, each in zip(drives, made, strict=True)
    ]
    return scoring.ceiling(state.case, tables).columns


def _features(drive: ChainDrive, base: Constants) -> dict[str, FloatArray]:
    path = path_of(drive, base)
    return features(drive, path, simulate(path, drive.period_s))


def _most_alike(table: FloatArray, known: FloatArray, target: FloatArray) -> int:
    """Return the column with the largest cosine to the target, both less the known columns."""
    q, _ = np.linalg.qr(known)
    rest = np.clip(target - q @ (q.T @ target), -scoring.LARGEST, scoring.LARGEST)
    own = table - q @ (q.T @ table)
    size, left = (table**2).sum(axis=0), (own**2).sum(axis=0)
    free = left > np.maximum(OWN_LEAST * size, 1e-9)
    return int(
        np.argmax(np.where(free, np.abs(own.T @ rest) / np.sqrt(np.where(free, left, 1.0)), 0.0))
    )


def _held_out(columns: FloatArray, target: FloatArray, blocks: IntArray) -> FloatArray:
    """Return the residual (m,) of the target, every fold by a least-squares fit without it."""
    rest = target.copy()
    fold = blocks % FOLDS
    for f in range(FOLDS):
        own = fold == f
        weights = np.linalg.lstsq(columns[~own], target[~own])[0]
        rest[own] -= columns[own] @ weights
    return rest
