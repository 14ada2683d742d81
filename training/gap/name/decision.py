"""The conclusion of one step: a name, several, an unknown effect, no gap, or the sensor."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.gap.name import guards
from training.gap.name.formulas.description import plainest
from training.gap.name.manoeuvres import ProposedDrive, separate
from training.gap.name.ranking import (
    HALF,
    RANKED_CLOSELY,
    WIN,
    adequacy_of,
    against,
    rank,
)
from training.gap.name.verdict import Candidate, Verdict
from training.greybox.effects.fuel.ethanol import GAIN_OF_ETHANOL
from training.greybox.fit.case import Prior, Term
from training.greybox.fit.joint import JointFit, fit
from training.healthy import scoring
from training.healthy.base_state import FREE, BaseState
from training.jobs import Progress

T_LEAST: Final = 3.0
T_STRANGE: Final = 2.0  # from which a constant of the wrong sign speaks against the best
AMBIGUOUS_MOST: Final = 3
GAIN_WORDS: Final = "the gain"
OFFSETS: Final = 1.5  # times healthy drives' own, from which an offset of all drives is one
GAIN_CLASS: Final = ("ethanol", "biased")  # a factor on the mixture, and what looks like it
GAIN_SUSPECTED: Final = (
    "a factor on the mixture (ethanol, humidity, slope errors) or a biased sensor"
)


@dataclass(frozen=True, slots=True)
class StepOutcome:
    """The conclusion of a step and its ranking."""

    verdict: Verdict
    ranking: tuple[Candidate, ...]  # best first
    best: tuple[Candidate, ...] = ()  # named, the ambiguous set, or effects alike to the fault
    suspected: str | None = None
    fault: Candidate | None = None  # suspected, as it was fitted; None of an onset or a moved base
    experiment: ProposedDrive | None = None


def step(
    state: BaseState,
    candidates: Sequence[Term],
    added: Sequence[Candidate],
    sensor_known_good: bool,
    progress: Progress,
    *,
    more: bool = False,
) -> StepOutcome:
    """Return the outcome of one forward step.

    more : whether another may follow; then the best of several that explain as much goes on,
        as the first of ``Outcome.best``
    """
    ranking = rank(state, candidates, progress)
    strong = [c for c in ranking if c.merit.physical and _holds(c)]
    strange = [c for c in ranking if not c.merit.physical and _holds(c, T_STRANGE)]
    if strong and (
        not _is_confirmed(state, strong[0]) or any(_rules_out(state, c, strong[0]) for c in strange)
    ):
        strong = []
    if strong:
        ranking, rivals = against(state, strong[0], ranking)
        strong = [strong[0], *rivals]
    return (
        _of_the_gain(state, ranking, sensor_known_good)
        or _at_fault(state, strong, ranking, sensor_known_good)
        or _of_effects(strong, ranking, more)
        or StepOutcome("no_gap" if added else _nothing(state, strange), ranking)
    )


def _holds(candidate: Candidate, t_least: float = T_LEAST) -> bool:
    """Return whether a gain is more than chance and even over the blocks that it moves."""
    return candidate.merit.is_large and candidate.merit.t >= t_least


def _rules_out(state: BaseState, strange: Candidate, best: Candidate) -> bool:
    """Return whether the best does not beat a candidate of the wrong sign."""
    blocks = state.case.blocks
    own, other = (scoring.deviance(c.fit, blocks) for c in (best, strange))
    return scoring.win(own, other) < WIN


def _is_confirmed(state: BaseState, best: Candidate) -> bool:
    """Return whether functions with far more freedom than an effect explain held-out blocks.

    An effect that gains where they lose follows a difference from drive to drive.
    """
    if best.kind == "sensor fault":
        return True
    return scoring.explained(state.current, state.roof, state.case.blocks) > 0.0


def _of_effects(
    strong: Sequence[Candidate], ranking: tuple[Candidate, ...], more: bool
) -> StepOutcome | None:
    """Return the name, or several that explain as much."""
    if not strong or strong[0].kind == "sensor fault":
        return None
    among = tuple(c for c in strong if c.kind == "effect")[:AMBIGUOUS_MOST]
    if len(among) == 1:
        return StepOutcome("named", ranking, best=among)
    verdict: Verdict = "named" if more else "ambiguous"
    return StepOutcome(
        verdict, ranking, best=among, experiment=separate(among[0].fit, among[1].fit)
    )


def _nothing(state: BaseState, strange: Sequence[Candidate]) -> Verdict:
    """Tell a gap that no candidate explains from no gap.

    strange : what is more than chance with constants that the effect cannot have
    """
    unlike = any(c.merit.is_large for c in strange) or plainest(state) is not None
    return "unknown_effect" if unlike else "no_gap"


def _is_felt(state: BaseState, fault: Candidate) -> bool:
    """Return whether a sensor fault is beyond chance and explains half of the ceiling."""
    if not fault.merit.is_large:
        return False
    share = fault.merit.adequacy
    if share is None:
        share = adequacy_of(state, fault.merit.score, fault.fit)
    return share >= HALF


def _stands_out(state: BaseState, fault: Candidate) -> bool:
    """Return whether no plain function of the signals clearly explains more than a sensor fault.

    The sensor's own fault may have another form, of which the library's explains a part.
    """
    plain = plainest(state)
    if plain is None:
        return True
    return scoring.win(plain.deviance, scoring.deviance(fault.fit, state.case.blocks)) < WIN


def _at_fault(
    state: BaseState,
    strong: Sequence[Candidate],
    ranking: tuple[Candidate, ...],
    sensor_known_good: bool,
) -> StepOutcome | None:
    """Suspect the sensor if a fault explains about as much, something began, or the base moved.

    Where a factor on the mixture explains most, a biased sensor does as well, see ``_of_the_gain``.
    """
    if sensor_known_good:
        return None
    if strong and strong[0].name == GAIN_CLASS[0]:
        return _of_a_factor(ranking, strong[0])
    at_fault = [c for c in strong if c.kind == "sensor fault" and _is_felt(state, c)]
    if (
        not at_fault
        and strong
        and strong[0].kind == "sensor fault"
        and _stands_out(state, strong[0])
    ):
        at_fault = [strong[0]]
    words = at_fault[0].name if at_fault else None
    as_good = _as_good(strong, ranking, words) if words else ()
    looked_at = strong[:1] or [c for c in ranking[:RANKED_CLOSELY] if c.merit.is_large]
    for candidate in () if words else looked_at:
        if strong and getattr(candidate.term, "varies", False):
            continue
        began = guards.onset_s(state.case, state.current, candidate.fit)
        if began is not None:
            words = f"it begins in {began[0]} at {began[1]:.0f} s"
    rivals = [c for c in ranking if c.kind == "sensor fault" or c.name in GAIN_CLASS]
    least = HALF * ranking[0].merit.score
    felt = not strong and any(c.merit.score >= least and _is_felt(state, c) for c in rivals)
    if words is None and felt and (shift := _shift(state)) is not None:
        words = f"{shift} left its healthy reference"
    if words is None:
        return None
    return StepOutcome(
        "sensor_fault_suspected",
        ranking,
        best=as_good[:AMBIGUOUS_MOST],
        suspected=words,
        fault=at_fault[0] if at_fault else None,
    )


def _as_good(
    strong: Sequence[Candidate], ranking: Sequence[Candidate], fault: str
) -> tuple[Candidate, ...]:
    """Return the effects that explain as much as a fault, and those that act as it does."""
    as_good = {c.name for c in strong}
    return tuple(
        c for c in ranking if c.kind == "effect" and (c.name in as_good or fault in c.like)
    )


def _shift(state: BaseState) -> str | None:
    """Return in words how the base alone, refitted, left its reference; None if it did not."""
    prior = state.case.prior
    if prior is None or state.current.terms:
        return None
    free = replace(state.case, prior=Prior(prior.mean, FREE), fixed=None, shrinks=())
    return guards.shifted(prior.mean, fit(free, (), [state.current]).base)


def _of_the_gain(
    state: BaseState, ranking: tuple[Candidate, ...], sensor_known_good: bool
) -> StepOutcome | None:
    """Suspect the sensor where a factor on the mixture or an offset explains the gap.

    A biased sensor in the control loop looks like another fuel: the controller makes the reading
    right, and what tells the two apart is smaller than what the base misses.
    """
    if _shift(state) != GAIN_WORDS or not _is_of_the_gain(state, ranking):
        return None
    effect = next((c for c in ranking if c.name == GAIN_CLASS[0]), None)
    if sensor_known_good and effect:
        return StepOutcome("named", ranking, best=(effect,))
    return _of_a_factor(ranking, effect)


def _of_a_factor(ranking: tuple[Candidate, ...], effect: Candidate | None) -> StepOutcome:
    """Suspect a factor on the mixture; ``effect`` is the library's, if it was tried."""
    best = (effect,) if effect else ()
    return StepOutcome(
        "sensor_fault_suspected", ranking, best=best, suspected=GAIN_SUSPECTED, fault=effect
    )


def _is_of_the_gain(state: BaseState, ranking: Sequence[Candidate]) -> bool:
    """Return whether a factor or offset explains most of the drives as they are.

    Healthy drives differ in fuel and weather, so an offset is integrated out of every drive. One
    of all drives then shows in its traces only, or not at all; here it is left in.
    """
    case = replace(state.case, shrinks=())
    nothing = fit(case, (), [state.current])
    whole = replace(
        state,
        case=case,
        roof=scoring.ceiling(case, scoring.plain_columns(case, state.current)),
        deviance=scoring.deviance(nothing, case.blocks),
    )

    def alone(candidate: Candidate) -> tuple[FloatArray, JointFit]:
        found = fit(case, candidate.fit.terms, [candidate.fit])
        return scoring.deviance(found, case.blocks), found

    best = ranking[0]
    rival = None if best.name in GAIN_CLASS else alone(best)[0]
    for candidate in (c for c in ranking if c.name in GAIN_CLASS):
        deviance, found = alone(candidate)
        offset = float(np.abs(found.parameters[-1]).max())
        size = offset * (GAIN_OF_ETHANOL if candidate.name == GAIN_CLASS[0] else 1.0)
        if size <= OFFSETS * state.offset_phi:
            continue
        gain = float((whole.deviance - deviance).sum())
        if adequacy_of(whole, gain, found) < HALF:
            continue
        if rival is None or scoring.win(deviance, rival) >= WIN:
            return True
    return False
