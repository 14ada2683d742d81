"""A term of a formula whose size grows with a second signal: what depends on two at once."""

from collections.abc import Sequence
from dataclasses import replace
from math import copysign
from typing import Final

import numpy as np

from training.gap.name.formulas.signal_functions import functions_of
from training.gap.name.formulas.signal_screen import NO_CAUSES
from training.gap.name.ranking import rank
from training.gap.name.verdict import Candidate
from training.greybox.effects import Effect
from training.greybox.effects.effect import Parameter
from training.greybox.effects.empirical import GROWTH, effect_of, growing, parts_of
from training.greybox.effects.shape import ScaledSignal
from training.greybox.fit.case import Case, errors, predict
from training.greybox.fit.drive import ChainDrive
from training.healthy import scoring
from training.healthy.base_state import BaseState

RANGE: Final = (0.02, 0.98)  # quantiles of a signal that u spans
STEP: Final = 0.01  # of growth, for derivatives


def grown(state: BaseState, term: Candidate) -> Candidate | None:
    """Return a term with the second signal that may explain most, fitted; None if none moves.

    state : without the term
    """
    names = dict.fromkeys(f.signal for f in functions_of(state.case.drives))
    others = [n for n in names if n not in (parts_of(term.name).over.signal, *NO_CAUSES)]
    moving = [scaled for n in others if (scaled := spanned(state.case.drives, n))]
    effects = [_with_a_second(term, scaled) for scaled in moving]
    best = max(effects, key=lambda each: _explained(state.case, term, each), default=None)
    return rank(state, [best])[0] if best else None


def spanned(drives: Sequence[ChainDrive], signal: str) -> ScaledSignal | None:
    """Return a signal so scaled that it goes from -1 to 1 in most samples; None if it rests."""
    x = np.concatenate([drive.signals[signal][drive.kept] for drive in drives])
    low, high = np.quantile(x, RANGE).tolist()
    return ScaledSignal(signal, (low + high) / 2.0, (high - low) / 2.0) if high > low else None


def _with_a_second(term: Candidate, second: ScaledSignal) -> Effect:
    """Return the effect that begins as the term is and grows with a second signal."""
    effect = effect_of(growing(term.name, *second))
    begun = (_begun(p, term.parameters.get(p.name)) for p in effect.parameters)
    return replace(effect, parameters=tuple(begun))


def _begun(parameter: Parameter, value: float | None) -> Parameter:
    """Return a constant that begins at a value, but no nearer to 0 than it usually begins.

    The start of a constant with a spread is its mean, and stays.
    """
    if value is None or parameter.spread is not None:
        return parameter
    least = abs(parameter.start[0])
    return replace(parameter, start=(copysign(max(abs(value), least), value),))


def _explained(case: Case, term: Candidate, effect: Effect) -> float:
    """Return by how much the sum of squares falls with a small growth, by least squares."""
    found = term.fit
    at = [p.name for p in effect.parameters].index(GROWTH.name)
    own = np.insert(found.parameters[-1], at, STEP)
    read = predict(case, found.base, (*found.terms[:-1], effect), [*found.parameters[:-1], own])
    growth = (errors(case, read) - found.residual) / STEP
    known = found.jacobian
    column = growth - known @ np.linalg.lstsq(known, growth)[0]
    target = np.clip(found.residual, -scoring.LARGEST, scoring.LARGEST)
    return float((column @ target) ** 2 / max(float(column @ column), 1e-9))
