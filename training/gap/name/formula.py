"""An effect that no library has, as a formula of recorded signals: searched for, scored, added.

Each form of the signals that may explain most is fitted and scored on held-out blocks as the
library's effects are; the best is kept, and a further one on top of it as long as it gains clearly.
Errors count as they are, slow ones too: an effect that follows a temperature is slow.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from monitor.base.types import FloatArray
from training.gap.name import scoring
from training.gap.name.ranking import State, rank
from training.gap.name.second_signal import grown
from training.gap.name.signal_functions import columns, functions_of
from training.gap.name.verdict import Candidate
from training.greybox.effects import Effect
from training.greybox.effects.empirical import effect_of, form_of, in_form, name_of, signal_of
from training.greybox.fit.joint import Fit, fit
from training.jobs.checkpoints import Progress

TERMS_MOST: Final = 3
SIGNALS_MOST: Final = 3  # whose forms are fitted
GAIN_LEAST: Final = 400.0  # of the first term in whitened errors, as for a clear plain function
T_LEAST: Final = 3.0  # of the first term, as for a name
FURTHER_T_LEAST: Final = 2.0
SHARE_LEAST: Final = 0.1  # of the deviance, that a term takes away
NEARLY: Final = 1.05  # times the least deviance, up to which a form of fewer constants goes first
RANGE: Final = (0.02, 0.98)  # quantiles that a curve spans
FORMS: Final = ("factor", "mass", "vapour", "slow", "curve")  # of every signal
PLACED: Final = ("bump", "step")  # of the best curves' signals, begun where the curve says
CURVES_MOST: Final = 2
BESIDE: Final = 0.1  # of u, from a knot: a fit cannot begin at 0
NO_CAUSES: Final = ("sensor_heater_percent",)  # answers the exhaust's flow and temperature


class Formula(NamedTuple):
    """The terms, none if nothing is clear."""

    terms: tuple[Candidate, ...] = ()  # of the fit to errors as they are, merits in whitened ones
    rival: Candidate | None = None  # the first term in whitened errors, as the sensor's faults are


def formula_of(state: State, progress: Progress = lambda _: None) -> Formula:
    """Return the formula of a state without effects."""
    plain, found = _plain(state), list[Candidate]()
    while len(found) < TERMS_MOST:
        progress("formula")
        best = _best(plain, {signal_of(c.name) for c in found})
        if best is None or best.merit.t < (FURTHER_T_LEAST if found else T_LEAST):
            break
        best = _growing(plain, best)
        found.append(best)
        plain = _with(plain, best.fit)
    terms = _needed(plain, found)
    judged = _judged(state, terms)
    if not judged or judged[0].merit.score < GAIN_LEAST:
        return Formula()
    pairs = zip(terms, judged, strict=True)
    return Formula(tuple(replace(c, merit=j.merit) for c, j in pairs), judged[0])


def _needed(plain: State, found: Sequence[Candidate]) -> list[Candidate]:
    """Return the terms without those that later ones have made superfluous."""
    kept = list(found)
    for each in found[:-1]:
        rest = [c for c in kept if c is not each]
        last = fit(plain.case, tuple(c.term for c in rest), [plain.current.base])
        if scoring.deviance(last, plain.case.blocks).sum() <= NEARLY * plain.deviance.sum():
            kept = [*rest[:-1], replace(rest[-1], fit=last)]
    return kept


def _judged(state: State, terms: Sequence[Candidate]) -> list[Candidate]:
    """Return the terms one after the other in whitened errors."""
    judged = list[Candidate]()
    for each in terms:
        (again,) = rank(state, [each.term])
        judged.append(again)
        state = _with(state, again.fit)
    return judged


def _with(state: State, found: Fit) -> State:
    deviance = scoring.deviance(found, state.case.blocks)
    return replace(state, current=found, deviance=deviance)


def _best(plain: State, used: Collection[str]) -> Candidate | None:
    """Return the best form of a signal that is not used yet, None if none gains enough."""
    terms = _forms(plain, used)
    if not terms:
        return None
    ranking = rank(plain, terms, closely=0)
    ranking = (*ranking, *rank(plain, _placed(ranking), closely=0))
    before = float(plain.deviance.sum())
    least = min(before - c.merit.score for c in ranking)
    most = min(NEARLY * least, (1.0 - SHARE_LEAST) * before)
    good = [c for c in ranking if before - c.merit.score <= most]
    return min(good, key=lambda c: (len(c.term.parameters), -c.merit.score), default=None)


def _growing(plain: State, best: Candidate) -> Candidate:
    """Return the best term, growing with a second signal if that takes away enough of the rest."""
    other, blocks = grown(plain, best, NO_CAUSES), plain.case.blocks
    if other is None:
        return best
    before, after = (scoring.deviance(c.fit, blocks) for c in (best, other))
    gained = scoring.score(before, after, scoring.moved(best.fit, other.fit, blocks))
    enough = gained.gain >= SHARE_LEAST * before.sum() and gained.t >= FURTHER_T_LEAST
    return other if enough else best


def _plain(state: State) -> State:
    case = scoring.as_they_are(state.case, state.current)
    current = fit(case, state.current.terms, [state.current])
    roof = scoring.ceiling(case, scoring.plain_columns(case, current))
    deviance = scoring.deviance(current, case.blocks)
    return replace(state, case=case, current=current, roof=roof, deviance=deviance)


def _forms(state: State, used: Collection[str]) -> list[Effect]:
    """Return the forms of the signals that may explain most, by least squares over all blocks."""
    drives = state.case.drives
    without = (*used, *NO_CAUSES)
    functions = [f for f in functions_of(drives) if f.signal not in without]
    if not functions:
        return []
    made = [columns(drive, state.current.base, functions) for drive in drives]
    table = scoring.ceiling(state.case, made).columns
    target = np.clip(-state.current.residual, -scoring.LARGEST, scoring.LARGEST)
    explained = {}
    for signal in dict.fromkeys(f.signal for f in functions):
        own = table[:, [f.signal == signal for f in functions]]
        explained[signal] = float(((own @ np.linalg.lstsq(own, target)[0]) ** 2).sum())
    forms = []
    for signal in sorted(explained, key=lambda s: -explained[s])[:SIGNALS_MOST]:
        x = np.concatenate([drive.signals[signal][drive.kept] for drive in drives])
        low, high = np.quantile(x, RANGE).tolist()
        if high > low:
            middle, half = (low + high) / 2.0, (high - low) / 2.0
            forms += [effect_of(name_of(signal, form, middle, half)) for form in FORMS]
    return forms


def _placed(ranking: Sequence[Candidate]) -> list[Effect]:
    """Return the forms with a place, of the signals with the best curves."""
    curves = [c for c in ranking if form_of(c.name) == "curve"]
    return [_begun(c, form) for c in curves[:CURVES_MOST] for form in PLACED]


def _begun(curve: Candidate, form: str) -> Effect:
    """Return a form of the curve's signal whose place begins where the curve shows it."""
    effect = effect_of(in_form(curve.name, form))
    place = _place_of(form, np.array(list(curve.parameters.values())))
    begun = (replace(p, start=(place,)) if p.name == "place" else p for p in effect.parameters)
    return replace(effect, parameters=tuple(begun))


def _place_of(form: str, values: FloatArray) -> float:
    """Return u of a curve's most unusual value (bump) or of its steepest part (step)."""
    knots = np.linspace(-1.0, 1.0, len(values)) + BESIDE
    if form == "bump":
        return float(knots[np.argmax(np.abs(values - np.median(values)))])
    steepest = int(np.argmax(np.abs(np.diff(values))))
    return float(knots[steepest : steepest + 2].mean())
