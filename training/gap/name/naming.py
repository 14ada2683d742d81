"""Which effect explains the gap between a base model and a vehicle, and whether one may say so.

Every effect of the library, and every gradual sensor fault as a rival, is fitted on the base and
scored on held-out blocks; the base is the healthy vehicle's, or is fitted with each candidate where
nothing is known of it. The verdict is read off the probabilities of all hypotheses
(``posterior``).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from training.gap.name.decision import StepOutcome
from training.gap.name.formulas.contest import beats, may_be_beaten, unbeaten
from training.gap.name.formulas.formula import FirstTerm, first_term, formula_of
from training.gap.name.posterior import NONE, UNKNOWN, Posterior
from training.gap.name.steps import Advance, advance
from training.gap.name.verdict import Answer, Base, BlockError, Candidate, Naming, Round, Trials
from training.greybox.chain import Constants
from training.greybox.effects import LIBRARY, Effect
from training.greybox.fit.case import Case, Term
from training.greybox.fit.drive import ChainDrive
from training.greybox.fit.joint import fit, held_out_rmse
from training.greybox.fit.sensor_faults import FAULTS
from training.healthy import scoring
from training.healthy.base_state import FREE, BaseState, base_state
from training.healthy.behaviour import Healthy
from training.jobs import Progress

CANDIDATES: Final = ("ambiguous", "unknown_effect")  # verdicts that may have some, not rounds
LARGER: Final = 1.6  # times the usual error on healthy drives, from which there is a gap


def name(
    drives: Sequence[ChainDrive],
    known: Healthy | None = None,
    reference: Constants | None = None,
    *,
    steps: int = 1,
    sensor_known_good: bool = False,
    progress: Progress = lambda _: None,
) -> Naming:
    """Return which effect, if any, explains the drives.

    drives : recordings of one vehicle with the gap
    known : the same vehicle when healthy; without it every weakness of the base itself is part of
        the gap
    reference : base constants of the healthy vehicle, if ``known`` is not given
    steps : effects to add at most, one after the other
    sensor_known_good : leave the sensor's faults out
    progress : is told what goes on
    Raises RecordingError if too little lies where healthy drives have been.
    """
    progress("the base on the new drives")
    first = base_state(drives, known, known.base if known else reference)
    skipped = {n: missing for n, e in LIBRARY.items() if (missing := _missing(e, drives))}
    candidates: list[Term] = [e for e in first.case.drives[0].effects if e.name not in skipped]
    if not sensor_known_good and first.case.prior is not None:
        candidates += FAULTS
    found = advance(first, candidates, steps, sensor_known_good, progress)
    answer = partial(_answer, first, skipped=skipped, known=known, reference=reference)
    naming, formula = answer(found), None
    is_told = naming.verdict != "unknown_effect" or bool(naming.answer.effects)
    if not is_told or may_be_beaten(first, found):
        progress("a formula of signals")
        formula = first_term(first)
    if is_told and formula and (won := beats(first, formula.rival, found)):
        unknown = StepOutcome("unknown_effect", found.first)
        odds = {name: (1.0 - won) * p for name, p in naming.posterior.items()}
        odds[UNKNOWN] += won  # of every hypothesis this share is the formula's
        found = Advance(first, unknown, (), found.first, odds)
        naming = answer(found)
    if naming.verdict == "unknown_effect" and not naming.answer.effects:
        naming = _with_formula(naming, formula, first, found.first)
    return naming


def _likeliest_first(odds: Posterior) -> Posterior:
    return dict(sorted(odds.items(), key=lambda each: -each[1]))


def _with_formula(
    naming: Naming, begun: FirstTerm | None, first: BaseState, ranking: Sequence[Candidate]
) -> Naming:
    """Return the naming of an unknown effect with its formula.

    The library goes before: a sensor fault or a reversed effect that a formula does not clearly
    beat is told instead, so is a fault that comes first where there is no formula.
    """
    large = (c for c in ranking if c.merit.is_large)
    library = [c for c in large if c.kind == "sensor fault" or c.is_reversed]
    if begun is None:
        found = next((c for c in library if c is ranking[0]), None)
    else:
        found = unbeaten(first, begun.rival, library)
    if found is not None and found.is_reversed:
        odds = dict(naming.posterior)  # the formula stands for other causes, and does not beat it
        odds[found.label] = odds.get(found.label, 0.0) + odds.pop(UNKNOWN)
        answer = replace(naming.answer, effects=(found,))
        error = _error(first, (found,))
        return replace(naming, answer=answer, error=error, posterior=_likeliest_first(odds))
    if found is not None:
        return replace(naming, answer=replace(naming.answer, suspected=found.name))
    if begun is None:
        return naming
    formula = formula_of(begun, first)
    return replace(
        naming,
        answer=replace(naming.answer, effects=formula.terms),
        error=replace(naming.error, after=formula.rmse),
    )


def _missing(effect: Effect, drives: Sequence[ChainDrive]) -> tuple[str, ...]:
    """Return the signals of an effect that some drive lacks."""
    return tuple(n for n in effect.needs if any(n not in d.signals for d in drives))


def _is_larger(rmse: float, drives: Sequence[ChainDrive], known: Healthy | None) -> bool:
    """Return whether the chain's error is larger than on healthy drives, whatever the reason.

    Slow errors hardly show in whitened ones, so there may be a gap that no candidate scores on.
    """
    usual = known.rmse_usual if known else None
    is_plain = not any(np.any(drive.moved_phi) for drive in drives)
    return is_plain and usual is not None and rmse > LARGER * usual


def _answer(
    first: BaseState,
    found: Advance,
    *,
    skipped: Mapping[str, tuple[str, ...]],
    known: Healthy | None,
    reference: Constants | None,
) -> Naming:
    last, outcome, rounds = found.last, found.outcome, found.rounds
    added = tuple(r.effect for r in rounds) if outcome.verdict == "named" else ()
    effects = added or (outcome.best if outcome.verdict in CANDIDATES else ())
    error = _error(first, () if outcome.verdict == "ambiguous" else effects)
    verdict, odds = outcome.verdict, found.posterior
    if verdict == "no_gap" and _is_larger(error.before, first.case.drives, known):
        verdict = "unknown_effect"
        odds = {**odds, NONE: 0.0, UNKNOWN: odds[UNKNOWN] + odds[NONE]}
    return Naming(
        verdict=verdict,
        answer=Answer(
            effects=effects,
            suspected=outcome.suspected,
            indistinguishable=outcome.best if verdict == "sensor_fault_suspected" else (),
            beside=found.beside if verdict in ("named", "sensor_fault_suspected") else (),
            experiment=outcome.experiment,
        ),
        trials=Trials(outcome.ranking, rounds if added else (), skipped),
        base=_base(first, last, known.base if known else reference),
        error=error,
        warnings=_warnings(first.case, known, rounds if verdict == "ambiguous" else ()),
        posterior=_likeliest_first(odds),
    )


def _error(first: BaseState, added: Sequence[Candidate]) -> BlockError:
    """Return the error without effects and with them; the last one's fit has all."""
    explained = float(scoring.explained(first.current, first.roof, first.case.blocks).sum())
    return BlockError(
        before=held_out_rmse(first.case, first.current),
        after=held_out_rmse(first.case, added[-1].fit) if added else None,
        floor=scoring.floor_phi(first.case, first.current),
        explained_share=explained / float(first.deviance.sum()),
    )


def _base(first: BaseState, last: BaseState, reference: Constants | None) -> Base:
    """Return the constants under the effects, and how far the base alone left its reference."""
    if reference is None:
        return Base(last.current.base, None, None)
    free = replace(first.case, prior=(reference, FREE), fixed=None)
    alone = fit(free, (), [first.current])
    shift = Constants(*(np.array(alone.base) - np.array(reference)).tolist())
    return Base(last.current.base, reference, shift)


def _warnings(case: Case, known: Healthy | None, first: Sequence[Round]) -> tuple[str, ...]:
    """Return what the answer cannot rest on; ``first`` came before an ambiguous set."""
    names = " and ".join(r.effect.name for r in first)
    said = {
        "no healthy recordings: a weakness of the base itself cannot be told from an effect": (
            known is None
        ),
        "no reference: a shift of gain, dead time or lag cannot be seen": case.prior is None,
        f"{names} came first and explains too little by itself to be named: "
        "the candidates are what may be there beside it": bool(first),
    }
    return tuple(text for text, holds in said.items() if holds)
