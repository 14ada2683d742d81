"""Constants of the named effects, from the recordings that are not held out.

There are up to three sets of constants, of which the best predictor is kept.

1. Those of the naming. It corrects the chain by its error on healthy drives and whitens errors:
   that tells effects from each other, but takes part of an effect's size, because the corrections
   follow signals that the effect has moved.
2. Those fitted to the plain errors of the chain alone.
3. Beside a network, those fitted to the network's errors beyond its errors on healthy drives,
   because the network reads an effect in its own way.
"""

from dataclasses import replace

import numpy as np

from training.gap.add.drive_weights import fit_weighted, left_out_ratio
from training.gap.inputs.subject import Subject
from training.gap.name.verdict import Naming
from training.greybox.chain import Constants
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.fit.case import Case
from training.greybox.fit.joint import JointFit, fit
from training.healthy import base, behaviour, scoring
from training.healthy.base_state import BaseState, base_state
from training.healthy.behaviour import Healthy


def constant_choices(
    subject: Subject, naming: Naming, known: Healthy | None, start: Constants
) -> list[tuple[ModelEffect, ...]]:
    """Return the named effects with every possible set of constants, the naming's first.

    A set is left out if, fitted to some of the recordings, it predicts the rest no better than no
    effect. A grey-box model takes over the base of the naming and gets the best set alone; beside
    a network stands the plain chain.
    """
    material, last = subject.material, naming.answer.effects[-1].fit
    state = base_state(subject.fit_drives, known, known.base if known else start)
    alone = _alone(state)
    # An effect that varies between drives would follow the drive in which it is strongest.
    also = () if any(getattr(term, "varies", False) for term in last.terms) else (alone,)
    if subject.is_greybox:
        found = [_alike(state, case, alone, last) for case in (state.case, *also)]
        return [_added(naming, fitted) for fitted, ratio in [min(found, key=_ratio)] if ratio < 1.0]
    found = [_alike(state, state.case, state.case, last)]
    if known and material.healthy:
        plain = replace(known, base=known.plain, own=(), charge=None)
        other = behaviour.learn(base.read_by(material.model, material.healthy), known.plain, plain)
        own = base_state(base.read_by(material.model, material.fit), other, other.base)
        found.append(_alike(own, own.case, own.case, last))
    found += [_alike(state, case, case, last) for case in also]
    return [_added(naming, fitted) for fitted, ratio in found if ratio < 1.0]


def _alone(state: BaseState) -> Case:
    """Return the case of the chain without corrections, errors as they are."""
    nothing = tuple(np.zeros(len(drive)) for drive in state.case.drives)
    return replace(scoring.as_they_are(state.case, state.current), corrections=nothing)


def _alike(state: BaseState, case: Case, judge: Case, last: JointFit) -> tuple[JointFit, float]:
    """Return the fit to drives that count alike, and ``left_out_ratio`` of it."""
    case, found = fit_weighted(case, fit(case, last.terms, [last]))
    return found, left_out_ratio(case, judge, state.current, found)


def _ratio(found: tuple[JointFit, float]) -> float:
    return found[1]


def _added(naming: Naming, found: JointFit) -> tuple[ModelEffect, ...]:
    """Return the named effects with the constants of a fit."""
    named = (c.name for c in naming.answer.effects)
    values = zip(named, found.parameters, found.standard_errors, strict=True)
    return tuple(
        ModelEffect.with_values(name, own.tolist(), errors.tolist()) for name, own, errors in values
    )
