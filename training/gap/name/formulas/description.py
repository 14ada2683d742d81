"""The unexplained error as a formula of few plain functions of a drive.

Functions are taken in one after the other, each time the one that the rest of the errors is most
alike to; the search ends when held-out blocks gain no more than chance would give.
Source: Pati, Rezaiifar, Krishnaprasad, Orthogonal matching pursuit, Asilomar 1993.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from monitor.base.types import FloatArray, IntArray
from training.gap.name.formulas.feature_words import words_of
from training.gap.name.formulas.signal_functions import columns, functions_of
from training.greybox.chain import Constants, simulate
from training.greybox.fit.comparison import FOLDS
from training.greybox.fit.constants import sandwich
from training.greybox.fit.drive import ChainDrive, path_of
from training.healthy import scoring
from training.healthy.base_state import BaseState
from training.healthy.features import features
from training.pages.numbers import percent

TERMS_MOST: Final = 4
GAIN_LEAST: Final = 80.0  # fall of the held-out deviance by a term, as for an effect to be named
CLEAR_GAIN: Final = 400.0  # of the best of all functions by itself, above what healthy drives give
CLEAR_T: Final = 4.0
T_LEAST: Final = 3.0  # of the signed square roots of the blocks' falls
SHARE_LEAST: Final = 0.05  # of what can be explained, that a term must add
ANSWERS: Final = ("trim",)  # what the controller makes of the mixture, no cause
NEARLY: Final = 0.95  # of the largest cosine
OTHERS_MOST: Final = 2
OWN_LEAST: Final = 0.02  # of a function's sum of squares that those taken already do not have


@dataclass(frozen=True, slots=True)
class Term:
    """One term of the formula."""

    name: str  # of the function in ``features``
    words: str
    coefficient: float  # measured minus predicted phi per function
    standard_error: float
    unit: str  # of the coefficient
    share: float  # of the deviance that can be explained at all, by adding this term
    or_else: tuple[str, ...]  # what the errors were nearly as alike to, in words

    @property
    def text(self) -> str:
        """Coefficient, its function, and functions that may be meant instead."""
        size = f"{self.coefficient:+.2g} ± {self.standard_error:.1g} {self.unit}"
        others = f" (or {', or '.join(self.or_else)})" if self.or_else else ""
        return f"{size} × {self.words}{others}"


@dataclass(frozen=True, slots=True)
class Description:
    """Measured minus predicted phi in few terms."""

    terms: tuple[Term, ...]  # in the order found

    @property
    def share(self) -> float:
        """Of the deviance that can be explained at all, by all terms."""
        return min(sum(term.share for term in self.terms), 1.0)

    @property
    def sentence(self) -> str:
        """Say it."""
        if not self.terms:
            return "No plain function of the signals describes what is left unexplained."
        parts = [term.text for term in self.terms]
        return (
            f"Measured minus predicted phi goes with {'; '.join(parts)}: "
            f"{percent(self.share)} of what can be explained."
        )


@dataclass(frozen=True, slots=True)
class Plain:
    """The plain function most like the errors, and its gain."""

    words: str
    score: scoring.Score
    deviance: FloatArray  # (n_blocks,) with it, held-out


def plainest(state: BaseState) -> Plain | None:
    """Return the best plain function, None if healthy drives may give it as much."""
    told, table = _plain(state)
    known, target, blocks = state.current.jacobian, -state.current.residual, state.case.blocks
    step = _next(table, known, _held_out(known, target, blocks), target, blocks)
    if step is None or step.score.gain < CLEAR_GAIN or step.score.t < CLEAR_T:
        return None
    return Plain(told[step.columns[0]].words, step.score, scoring.by_block(step.rest, blocks))


def describe(state: BaseState) -> Description:
    """Return a sparse formula of the errors that are left.

    Shares are of the fall of held-out deviance by all terms and what the ceiling explains of what
    they leave.
    """
    blocks = state.case.blocks
    told, table = _plain(state)
    known, target = state.current.jacobian, -state.current.residual
    by_ceiling = float(scoring.explained(state.current, state.roof, blocks).sum())
    steps = _pursue(table, known, target, blocks, max(GAIN_LEAST, SHARE_LEAST * by_ceiling))
    design = np.column_stack([table[:, [step.columns[0] for step in steps]], known])
    weights = np.linalg.lstsq(design, target)[0]
    errors = np.sqrt(np.diag(sandwich(design, target - design @ weights, blocks)))
    rest = _held_out(design, target, blocks)
    further = scoring.left_by(state.roof, design, rest, blocks)
    more = scoring.by_block(rest, blocks).sum() - scoring.by_block(further, blocks).sum()
    explainable = sum(step.score.gain for step in steps) + max(float(more), 0.0)
    terms = []
    for step, weight, error in zip(steps, weights.tolist(), errors.tolist(), strict=False):
        best, *others = (told[i] for i in step.columns)
        or_else = tuple(other.words for other in others)
        share = step.score.gain / explainable
        terms.append(
            Term(
                name=best.name,
                words=best.words,
                coefficient=weight,
                standard_error=error,
                unit=best.unit,
                share=share,
                or_else=or_else,
            )
        )
    return Description(tuple(terms))


class _Step(NamedTuple):
    columns: list[int]  # the best and those nearly as good
    score: scoring.Score
    rest: FloatArray  # (m,) what is left on held-out blocks


def _pursue(
    table: FloatArray, known: FloatArray, target: FloatArray, blocks: IntArray, least: float
) -> list[_Step]:
    """Take columns in until held-out blocks gain less than ``least`` or no more than chance."""
    steps: list[_Step] = []
    rest = _held_out(known, target, blocks)
    while len(steps) < TERMS_MOST:
        used = np.column_stack([known, table[:, [step.columns[0] for step in steps]]])
        step = _next(table, used, rest, target, blocks)
        if step is None or step.score.gain < least or step.score.t < T_LEAST:
            break
        steps.append(step)
        rest = step.rest
    return steps


def _next(
    table: FloatArray, used: FloatArray, rest: FloatArray, target: FloatArray, blocks: IntArray
) -> _Step | None:
    """Return the next column to take in, None if there is none."""
    found = _most_alike(table, used, target)
    if not found:
        return None
    after = _held_out(np.column_stack([used, table[:, found[0]]]), target, blocks)
    moved = np.bincount(blocks, (after - rest) ** 2).astype(np.float64)
    before, now = (scoring.by_block(e, blocks) for e in (rest, after))
    return _Step(found, scoring.score(before, now, moved), after)


class _Column(NamedTuple):
    name: str
    words: str
    unit: str


def _plain(state: BaseState) -> tuple[list[_Column], FloatArray]:
    """Return the functions that all drives have, and their values (m, k) as errors are."""
    drives, base = state.case.drives, state.current.base
    made = [_features(drive, base) for drive in drives]
    shared = [n for n in made[0] if n not in ANSWERS and all(n in each for each in made)]
    own = functions_of(drives)
    told = [_Column(n, *words_of(n)) for n in shared]
    told += [_Column(f"{f.signal} {f.kind} {f.at:g}", f.words, f.unit) for f in own]
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
