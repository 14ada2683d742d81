"""The plain function of a drive that the unexplained error is most like."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.types import FloatArray, IntArray
from training.gap.name.formulas.feature_words import words_of
from training.gap.name.formulas.signal_functions import columns, functions_of
from training.greybox.chain import Constants, simulate
from training.greybox.fit.comparison import FOLDS
from training.greybox.fit.drive import ChainDrive, path_of
from training.healthy import scoring
from training.healthy.base_state import BaseState
from training.healthy.features import features

GAIN_LEAST: Final = 80.0  # fall of the held-out deviance, as for an effect to be named
T_LEAST: Final = 3.0  # of the signed square roots of the blocks' falls
CLEAR_GAIN: Final = 400.0  # above what healthy drives give
CLEAR_T: Final = 4.0
ANSWERS: Final = ("trim",)  # what the controller makes of the mixture, no cause
NEARLY: Final = 0.95  # of the largest cosine
OTHERS_MOST: Final = 2
OWN_LEAST: Final = 0.02  # of a function's sum of squares that the base's constants do not have


@dataclass(frozen=True, slots=True)
class Plain:
    """The plain function most like the errors, and its gain."""

    words: tuple[str, ...]  # of the function, then of those that may be meant instead
    score: scoring.Score
    deviance: FloatArray  # (n_blocks,) with it, held-out


def plainest(
    state: BaseState, gain_least: float = CLEAR_GAIN, t_least: float = CLEAR_T
) -> Plain | None:
    """Return the best plain function, None if it gains less than wanted."""
    told, table = _plain(state)
    known, target, blocks = state.current.jacobian, -state.current.residual, state.case.blocks
    found = _most_alike(table, known, target)
    if not found:
        return None
    before = _held_out(known, target, blocks)
    after = _held_out(np.column_stack([known, table[:, found[0]]]), target, blocks)
    moved = np.bincount(blocks, (after - before) ** 2).astype(np.float64)
    left = scoring.by_block(after, blocks)
    score = scoring.score(scoring.by_block(before, blocks), left, moved)
    if score.gain < gain_least or score.t < t_least:
        return None
    return Plain(tuple(told[i] for i in found), score, left)


def describe(state: BaseState) -> str:
    """Return a sentence about an effect that has neither a name nor a formula."""
    plain = plainest(state, GAIN_LEAST, T_LEAST)
    if plain is None:
        return "No plain function of the signals describes what is left unexplained."
    return f"Measured minus predicted phi goes most with {', or '.join(plain.words)}."


def _plain(state: BaseState) -> tuple[list[str], FloatArray]:
    """Return the functions that all drives have, and their values (m, k) as errors are."""
    drives, base = state.case.drives, state.current.base
    made = [_features(drive, base) for drive in drives]
    shared = [n for n in made[0] if n not in ANSWERS and all(n in each for each in made)]
    own = functions_of(drives)
    told = [*map(words_of, shared), *(f.words for f in own)]
    tables = [
        np.column_stack([*(each[n] for n in shared), columns(drive, base, own)])
        for drive, each in zip(drives, made, strict=True)
    ]
    return told, scoring.ceiling(state.case, tables).columns


def _features(drive: ChainDrive, base: Constants) -> dict[str, FloatArray]:
    path = path_of(drive, base)
    return features(drive, path, simulate(path, drive.period_s))


def _most_alike(table: FloatArray, known: FloatArray, target: FloatArray) -> list[int]:
    """Return the column with the largest cosine to the target less the chosen columns.

    Up to two columns that are nearly as alike follow it.
    """
    q, _ = np.linalg.qr(known)
    rest = np.clip(target - q @ (q.T @ target), -scoring.LARGEST, scoring.LARGEST)
    own = table - q @ (q.T @ table)
    size, left = (table**2).sum(axis=0), (own**2).sum(axis=0)
    free = left > np.maximum(OWN_LEAST * size, 1e-9)
    alike = np.where(free, np.abs(own.T @ rest) / np.sqrt(np.where(free, left, 1.0)), 0.0)
    order = np.argsort(-alike)[: 1 + OTHERS_MOST]
    return [int(i) for i in order if alike[i] > NEARLY * alike[order[0]]]


def _held_out(columns: FloatArray, target: FloatArray, blocks: IntArray) -> FloatArray:
    """Return the residual (m,) of the target, every fold by a least-squares fit without it."""
    rest = target.copy()
    fold = blocks % FOLDS
    for f in range(FOLDS):
        own = fold == f
        weights = np.linalg.lstsq(columns[~own], target[~own])[0]
        rest[own] -= columns[own] @ weights
    return rest
