"""The conclusion of one step: a name, several, an unknown effect, no gap, or the sensor."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.gap.name import guards, scoring
from training.gap.name.base_state import FREE
from training.gap.name.description import Plain, plainest
from training.gap.name.manoeuvres import Experiment, separate
from training.gap.name.ranking import (
    ADEQUATE,
    RANKED_CLOSELY,
    RIVAL_SCORE,
    WIN,
    State,
    adequacy_of,
    against,
    matters,
    rank,
)
from training.gap.name.verdict import Candidate, Verdict
from training.greybox.effects.ethanol import GAIN_OF_ETHANOL
from training.greybox.fit.joint import Fit, Prior, Term, fit
from training.jobs.checkpoints import Progress

T_LEAST: Final = 3.0
T_STRANGE: Final = 2.0  # from which a constant of the wrong sign speaks against the best
LARGE: Final = 2.0  # times the score needed, far more than healthy drives give
FAULT_ADEQUATE: Final = 0.5
AMBIGUOUS_MOST: Final = 3
EQUAL: Final = 0.9  # of a score, from which it is as good
GAIN_WORDS: Final = "the gain"
OFFSETS: Final = 1.5  # times healthy drives' own, from which an offset of all drives is one
GAIN_CLASS: Final = ("ethanol", "biased")  # a factor on the mixture, and what looks like it
BIAS_NEAR: Final = 0.75  # of the best score: in the loop a bias is close to much that loses to it
GAIN_SUSPECTED: Final = (
    "a factor on the mixture (ethanol, humidity, slope errors) or a biased sensor"
)


@dataclass(frozen=True, slots=True)
class Outcome:
    """The conclusion of a step and its ranking."""

    verdict: Verdict
    ranking: tuple[Candidate, ...]  # best first
    best: tuple[Candidate, ...] = ()  # named, the ambiguous set, or effects alike to the fault
    suspected: str | None = None
    experiment: Experiment | None = None


def step(
    state: State,
    candidates: Sequence[Term],
    added: Sequence[Candidate],
    sensor_known_good: bool,
    progress: Progress,
    *,
    more: bool = False,
) -> Outcome:
    """Return the outcome of one forward step.

    more : whether another may follow; then of two that explain a part each the better one goes on
    """
    ranking = rank(state, candidates, progress)
    held = [c for c in ranking if _holds(c)]
    strong = [c for c in held if matters(c)]
    strange = [c for c in ranking if not c.merit.physical and _holds(c, T_STRANGE)]
    strange += [c for c in held[:1] if c.merit.physical and c not in strong]
    plain = plainest(state)
    no_rival = plain is not None and _is_no_rival(state, ranking[0], plain)
    if strong and (
        no_rival
        or not _is_confirmed(state, strong[0])
        or any(_rules_out(state, c, strong[0]) for c in strange)
    ):
        strong = []
    if strong:
        ranking, rivals = against(state, strong[0], ranking)
        strong = [strong[0], *rivals]
    return (
        (None if no_rival else _of_the_gain(state, ranking, sensor_known_good))
        or _at_fault(state, strong, ranking, sensor_known_good)
        or _of_effects(strong, ranking, more)
        or Outcome(_nothing(added, strange, plain), ranking)
    )


def _holds(candidate: Candidate, t_least: float = T_LEAST) -> bool:
    """Return whether a gain is more than chance and even over the blocks that it moves."""
    merit = candidate.merit
    return merit.score >= merit.needed and merit.t >= t_least


def _rules_out(state: State, strange: Candidate, best: Candidate) -> bool:
    """Return whether an implausible candidate (too small, or wrong sign) beats the best."""
    if strange.merit.physical:
        return best.merit.score < EQUAL * strange.merit.score
    blocks = state.case.blocks
    own, other = (scoring.deviance(c.fit, blocks) for c in (best, strange))
    return scoring.win(own, other) < WIN


def _is_confirmed(state: State, best: Candidate) -> bool:
    """Return whether functions with far more freedom than an effect explain held-out blocks.

    An effect that gains where they lose follows a difference from drive to drive.
    """
    if best.kind == "sensor fault":
        return True
    return scoring.explained(state.current, state.roof, state.case.blocks) > 0.0


def _is_no_rival(state: State, best: Candidate, plain: Plain) -> bool:
    """Return whether one plain function of a signal explains far more than the best candidate."""
    own = scoring.deviance(best.fit, state.case.blocks)
    far = best.merit.score < RIVAL_SCORE * plain.score.gain
    return far and scoring.win(plain.deviance, own) >= WIN


def _is_large(candidate: Candidate) -> bool:
    """Return whether the gain is far more than healthy drives give, if only in some blocks."""
    return candidate.merit.score > LARGE * candidate.merit.needed


def _of_effects(
    strong: Sequence[Candidate], ranking: tuple[Candidate, ...], more: bool
) -> Outcome | None:
    """Return the name, or several that explain as much.

    Neither a fault that explains little is an answer nor several of which none explains enough.
    """
    if not strong or strong[0].kind == "sensor fault":
        return None
    best, among = strong[0], tuple(c for c in strong if c.kind == "effect")[:AMBIGUOUS_MOST]
    parts = all((c.merit.adequacy or 0.0) < ADEQUATE for c in among)
    if len(among) == 1 or (parts and more):
        return Outcome("named", ranking, best=(best,))
    if parts:
        return Outcome("unknown_effect", ranking)
    return Outcome("ambiguous", ranking, best=among, experiment=separate(best.fit, among[1].fit))


def _nothing(
    added: Sequence[Candidate], strange: Sequence[Candidate], plain: Plain | None
) -> Verdict:
    """Tell a gap that no candidate explains from no gap.

    strange : what is more than chance with constants that the effect cannot have, or too small
    """
    if added:
        return "no_gap"
    unlike = any(_is_large(c) and not c.merit.physical for c in strange)
    return "unknown_effect" if unlike or plain is not None else "no_gap"


def _is_felt(state: State, fault: Candidate) -> bool:
    """Return whether a sensor fault is beyond chance and explains half of the ceiling."""
    if not (_is_large(fault) or _holds(fault)):
        return False
    share = fault.merit.adequacy
    if share is None:
        share = adequacy_of(state, fault.merit.score, fault.fit)
    return share >= FAULT_ADEQUATE


def _at_fault(
    state: State,
    strong: Sequence[Candidate],
    ranking: tuple[Candidate, ...],
    sensor_known_good: bool,
) -> Outcome | None:
    """Suspect the sensor if a fault explains about as much, something began, or the base moved.

    Where a factor on the mixture explains most, a biased sensor does as well, see ``_of_the_gain``.
    """
    if sensor_known_good:
        return None
    if strong and strong[0].name == GAIN_CLASS[0]:
        factor = (strong[0],)
        return Outcome("sensor_fault_suspected", ranking, best=factor, suspected=GAIN_SUSPECTED)
    near = [c for c in ranking if strong and _is_near_bias(c, strong[0])]
    at_fault = [c for c in (*strong, *near) if c.kind == "sensor fault" and _is_felt(state, c)]
    words = at_fault[0].name if at_fault else None
    as_good = _as_good(strong, ranking, words) if words else ()
    looked_at = strong[:1] or [c for c in ranking[:RANKED_CLOSELY] if _is_large(c)]
    for candidate in () if words else looked_at:
        if strong and getattr(candidate.term, "varies", False):
            continue
        began = guards.onset_s(state.case, state.current, candidate.fit)
        if began is not None:
            words = f"it begins in {began[0]} at {began[1]:.0f} s"
    rivals = [c for c in ranking if c.kind == "sensor fault" or c.name in GAIN_CLASS]
    least = RIVAL_SCORE * ranking[0].merit.score
    felt = not strong and any(c.merit.score >= least and _is_felt(state, c) for c in rivals)
    if words is None and felt and (shift := _shift(state)) is not None:
        words = f"{shift} left its healthy reference"
    if words is None:
        return None
    return Outcome(
        "sensor_fault_suspected", ranking, best=as_good[:AMBIGUOUS_MOST], suspected=words
    )


def _as_good(
    strong: Sequence[Candidate], ranking: Sequence[Candidate], fault: str
) -> tuple[Candidate, ...]:
    """Return the effects that explain as much as a fault, and those that act as it does."""
    as_good = {c.name for c in strong}
    return tuple(
        c for c in ranking if c.kind == "effect" and (c.name in as_good or fault in c.like)
    )


def _is_near_bias(candidate: Candidate, best: Candidate) -> bool:
    """Return whether a candidate is a biased sensor that explains nearly as much as the best."""
    near = candidate.merit.score >= BIAS_NEAR * best.merit.score
    return candidate.name == GAIN_CLASS[1] and near and matters(candidate)


def _shift(state: State) -> str | None:
    """Return in words how the base alone, refitted, left its reference; None if it did not."""
    prior = state.case.prior
    if prior is None or state.current.terms:
        return None
    free = replace(state.case, prior=Prior(prior.mean, FREE), fixed=None, shrinks=())
    return guards.shifted(prior.mean, fit(free, (), [state.current]).base)


def _of_the_gain(
    state: State, ranking: tuple[Candidate, ...], sensor_known_good: bool
) -> Outcome | None:
    """Suspect the sensor where a factor on the mixture or an offset explains the gap.

    A biased sensor in the control loop looks like another fuel: the controller makes the reading
    right, and what tells the two apart is smaller than what the base misses.
    """
    if _shift(state) != GAIN_WORDS or not _is_of_the_gain(state, ranking):
        return None
    effect = tuple(c for c in ranking if c.name == GAIN_CLASS[0])
    if sensor_known_good and effect:
        return Outcome("named", ranking, best=effect)
    return Outcome("sensor_fault_suspected", ranking, best=effect, suspected=GAIN_SUSPECTED)


def _is_of_the_gain(state: State, ranking: Sequence[Candidate]) -> bool:
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

    def alone(candidate: Candidate) -> tuple[FloatArray, Fit]:
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
        if adequacy_of(whole, gain, found) < FAULT_ADEQUATE:
            continue
        if rival is None or scoring.win(deviance, rival) >= WIN:
            return True
    return False
