"""An effect that no library has, as a formula of recorded signals: searched for, scored, added.

Each form of the signals that may explain most is fitted and scored on held-out blocks as the
library's effects are; the best is kept, and a further one on top of it as long as it gains clearly.
Errors count as they are, slow ones too: an effect that follows a temperature is slow.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from monitor.base.types import FloatArray
from training.gap.name.formulas.second_signal import grown, spanned
from training.gap.name.formulas.signal_screen import left_by_signal
from training.gap.name.ranking import rank
from training.gap.name.verdict import Candidate
from training.greybox.effects import Effect
from training.greybox.effects.empirical import effect_of, name_of, parts_of
from training.greybox.fit.joint import JointFit, fit, held_out_rmse
from training.healthy import scoring
from training.healthy.base_state import BaseState
from training.healthy.without import corrections

TERMS_MOST: Final = 3
SIGNALS_MOST: Final = 3  # whose forms are fitted
GAIN_LEAST: Final = 400.0  # of the first term in whitened errors
T_LEAST: Final = 3.0  # of the first term, as for a name
FURTHER_T_LEAST: Final = 2.0
SHARE_LEAST: Final = 0.1  # of the deviance, that a term takes away
NEARLY: Final = 1.05  # times the least deviance, up to which a form of fewer constants goes first
FORMS: Final = ("factor", "mass", "vapour", "slow", "curve")  # of every signal
PLACED: Final = ("bump", "step", "bend", "exponential")  # begun where the best curves show it
CURVES_MOST: Final = 2
RATES: Final = (-4.0, -2.0, -1.0, 1.0, 2.0, 4.0)  # of an exponential per u, for a fit to begin at
SHOWN: Final = ("place", "rate")  # constants that a curve shows
BESIDE: Final = 0.1  # of u, from a knot: a fit cannot begin at 0


class Formula(NamedTuple):
    """The terms, at least one."""

    terms: tuple[Candidate, ...]  # of the fit to errors as they are, merits in whitened ones
    rmse: float  # of the terms on held-out blocks, in phi


@dataclass(frozen=True, slots=True)
class FirstTerm:
    """The first term of a formula: the form that a rival of effects and faults has."""

    term: Candidate  # of the fit to errors as they are
    rival: Candidate  # in whitened errors, as effects and the sensor's faults are
    plain: BaseState  # errors as they are, with the term


def first_term(state: BaseState) -> FirstTerm | None:
    """Return the first term of a formula, None if none is clear and even over the blocks.

    state : without effects; the healthy vehicle's errors become those that it shows without the
        term
    """
    plain = _plain(state)
    if rough := rank(plain, _forms(plain, (), ("curve",)), lambda _: None):
        plain = reread(plain, rough[0].fit)
    found = _next(plain, (), T_LEAST)
    if found is None:
        return None
    term, plain = found
    (rival,) = rank(state, [term.term])
    return FirstTerm(term, rival, plain) if rival.merit.score >= GAIN_LEAST else None


def formula_of(first: FirstTerm, state: BaseState) -> Formula:
    """Return the formula that begins with a term, beside no effect."""
    plain, found = first.plain, [first.term]
    while len(found) < TERMS_MOST:
        used = {parts_of(c.name).over.signal for c in found}
        more = _next(plain, used, FURTHER_T_LEAST)
        rmse = held_out_rmse(plain.case, found[-1].fit)
        if more is None or held_out_rmse(more[1].case, more[0].fit) > rmse:
            break
        term, plain = more
        found.append(term)
    terms = _needed(plain, found)
    pairs = zip(terms, _judged(state, terms), strict=True)
    merited = tuple(replace(c, merit=j.merit) for c, j in pairs)
    return Formula(merited, held_out_rmse(plain.case, terms[-1].fit))


def _next(
    plain: BaseState, used: Collection[str], t_least: float
) -> tuple[Candidate, BaseState] | None:
    """Return the best further term, and the state with it."""
    best = _best(plain, used)
    if best is None or best.merit.t < t_least:
        return None
    plain = reread(plain, best.fit)
    best = replace(best, fit=fit(plain.case, best.fit.terms, [best.fit]))
    return best, plain.with_fit(best.fit)


def reread(plain: BaseState, found: JointFit) -> BaseState:
    """Return the state with the healthy vehicle's errors as it shows them without the terms."""
    if plain.known is None:
        return plain
    drives = plain.case.drives
    case = replace(plain.case, corrections=corrections(plain.known, drives, found.effects))
    current = fit(case, plain.current.terms, [plain.current])
    return replace(plain, case=case).with_fit(current)


def _needed(plain: BaseState, found: Sequence[Candidate]) -> list[Candidate]:
    """Return the terms without those that later ones have made superfluous."""
    kept = list(found)
    for each in found[:-1]:
        rest = [c for c in kept if c is not each]
        last = fit(plain.case, tuple(c.term for c in rest), [plain.current.base])
        if scoring.deviance(last, plain.case.blocks).sum() <= NEARLY * plain.deviance.sum():
            kept = [*rest[:-1], replace(rest[-1], fit=last)]
    return kept


def _judged(state: BaseState, terms: Sequence[Candidate]) -> list[Candidate]:
    """Return the terms one after the other in whitened errors."""
    judged = list[Candidate]()
    for each in terms:
        (again,) = rank(state, [each.term])
        judged.append(again)
        state = state.with_fit(again.fit)
    return judged


def _best(plain: BaseState, used: Collection[str]) -> Candidate | None:
    """Return the best term, growing or not, of an unused signal; None if none gains enough."""
    ranking = rank(plain, _forms(plain, used))
    curves = [c for c in ranking if parts_of(c.name).form == "curve"][:CURVES_MOST]
    ranking = (*ranking, *rank(plain, [_begun(c, form) for c in curves for form in PLACED]))
    by_signal = dict[str, list[Candidate]]()
    for each in ranking:
        by_signal.setdefault(parts_of(each.name).over.signal, []).append(each)
    grown = [_growing(plain, _simplest(forms)) for forms in by_signal.values()]
    most = (1.0 - SHARE_LEAST) * float(plain.deviance.sum())
    good = [c for c in grown if c.left.sum() <= most]
    return _simplest(good) if good else None


def _simplest(terms: Sequence[Candidate]) -> Candidate:
    """Return the term of fewest constants of those that leave nearly the least."""
    most = NEARLY * min(float(c.left.sum()) for c in terms)
    good = [c for c in terms if c.left.sum() <= most]
    return min(good, key=lambda c: (len(c.term.parameters), -c.merit.score))


def _growing(plain: BaseState, best: Candidate) -> Candidate:
    """Return the best term, growing with a second signal if that takes away enough of the rest."""
    other, blocks = grown(plain, best), plain.case.blocks
    if other is None:
        return best
    gained = scoring.score(best.left, other.left, scoring.moved(best.fit, other.fit, blocks))
    enough = gained.gain >= SHARE_LEAST * best.left.sum() and gained.t >= FURTHER_T_LEAST
    return other if enough else best


def _plain(state: BaseState) -> BaseState:
    case = scoring.as_they_are(state.case, state.current)
    current = fit(case, state.current.terms, [state.current])
    roof = scoring.ceiling(case, scoring.plain_columns(case, current))
    return replace(state, case=case, roof=roof).with_fit(current)


def _forms(state: BaseState, used: Collection[str], forms: Sequence[str] = FORMS) -> list[Effect]:
    """Return the forms of the signals that may explain most."""
    best = [*left_by_signal(state, used)][:SIGNALS_MOST]
    moving = [scaled for signal in best if (scaled := spanned(state.case.drives, signal))]
    return [effect_of(name_of(over.signal, form, *over[1:])) for over in moving for form in forms]


def _begun(curve: Candidate, form: str) -> Effect:
    """Return a form of the curve's signal that begins where the curve shows it."""
    effect = effect_of(name_of(form=form, **parts_of(curve.name).over._asdict()))
    values = np.array(list(curve.parameters.values()))
    start = _rate_of(values) if form == "exponential" else _place_of(form, values)
    begun = (replace(p, start=(start,)) if p.name in SHOWN else p for p in effect.parameters)
    return replace(effect, parameters=tuple(begun))


def _place_of(form: str, values: FloatArray) -> float:
    """Return u of a curve's most unusual value (bump), steepest part (step) or corner (bend)."""
    knots = np.linspace(-1.0, 1.0, len(values)) + BESIDE
    if form == "bump":
        return float(knots[np.argmax(np.abs(values - np.median(values)))])
    if form == "bend":
        return float(knots[1:-1][np.argmax(np.abs(np.diff(values, 2)))])
    steepest = int(np.argmax(np.abs(np.diff(values))))
    return float(knots[steepest : steepest + 2].mean())


def _rate_of(values: FloatArray) -> float:
    """Return the rate per u of the exponential that is nearest to a curve."""
    knots = np.linspace(-1.0, 1.0, len(values))
    left = []
    for rate in RATES:
        table = np.column_stack([np.ones(len(knots)), np.exp(rate * knots - abs(rate))])
        left.append(float(np.sum((values - table @ np.linalg.lstsq(table, values)[0]) ** 2)))
    return RATES[int(np.argmin(left))]
