"""A term of a formula whose size grows with a second signal: what depends on two at once."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import copysign
from typing import Final

import numpy as np

from training.gap.name.formulas.signal_functions import functions_of
from training.gap.name.ranking import rank
from training.gap.name.verdict import Candidate
from training.greybox.effects import Effect
from training.greybox.effects.effect import Parameter
from training.greybox.effects.empirical import GROWTH, effect_of, growing, parts_of
from training.greybox.fit.case import Case, errors, predict
from training.greybox.fit.drive import ChainDrive
from training.healthy import scoring
from training.healthy.base_state import BaseState

RANGE: Final = (0.02, 0.98)  # quantiles of the second signal that u spans
STEP: Final = 0.01  # of growth, for derivatives


def grown(state: BaseState, term: Candidate, without: Sequence[str]) -> Candidate | None:
    """Return a term with the second signal that may explain most, fitted; None if none moves.

    state : without the term
    without : signals that are no second one
    """
    names = dict.fromkeys(f.signal for f in functions_of(state.case.drives))
    others = [n for n in names if n not in (parts_of(term.name).over.signal, *without)]
    effects = [e for n in others for e in _with_a_second(state.case.drives, term, n)]
    best = max(effects, key=lambda each: _explained(state.case, term, each), default=None)
    return rank(state, [best])[0] if best else None


def _with_a_second(drives: Sequence[ChainDrive], term: Candidate, signal: str) -> Iterator[Effect]:
    """Yield the effect that begins as the term is, if the second signal moves."""
    x = np.concatenate([drive.signals[signal][drive.kept] for drive in drives])
    low, high = np.quantile(x, RANGE).tolist()
    if high <= low:
        return
    effect = effect_of(growing(term.name, signal, (low + high) / 2.0, (high - low) / 2.0))
    begun = (_begun(p, term.parameters.get(p.name)) for p in effect.parameters)
    yield replace(effect, parameters=tuple(begun))


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
