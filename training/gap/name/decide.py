"""What one step concludes: a name, several, none that explains enough, nothing, or the sensor."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from monitor.types import FloatArray
from training.gap.effects.fuel import ETHANOL_AIR_FUEL, PETROL_AIR_FUEL
from training.gap.name import guards, scoring
from training.gap.name.begin import FREE
from training.gap.name.fitting import Fit, Prior, Term, fit
from training.gap.name.manoeuvres import Experiment, separate
from training.gap.name.ranking import (
    ADEQUATE,
    RANKED_CLOSELY,
    RIVAL_SCORE,
    WIN,
    Progress,
    State,
    against,
    matters,
    rank,
)
from training.gap.name.verdict import Candidate, Verdict

T_LEAST: Final = 3.0
FEW: Final = 3.0  # times the score needed, for an effect that lives in few blocks, where t is small
FAULT_ADEQUATE: Final = 0.5
CEILING_SHARE: Final = 0.045  # of the deviance: what healthy drives leave to explain stays below
WIN_OF_FEW: Final = 0.99  # of resampled blocks, over no effect
AMBIGUOUS_MOST: Final = 3
EQUAL: Final = 0.9  # of a score, from which it is as good
CEILING_T: Final = 5.5
GAIN_WORDS: Final = "the gain"
OFFSETS: Final = 2.0  # times healthy drives' own, from which an offset of all drives is one
GAIN_OF_ETHANOL: Final = 1.0 - ETHANOL_AIR_FUEL / PETROL_AIR_FUEL  # of the mixture, per fraction
GAIN_CLASS: Final = ("ethanol", "biased")  # a factor on the mixture, and what looks like it


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a step concludes and what it looked at."""

    verdict: Verdict
    best: tuple[Candidate, ...]  # the named one, or the ambiguous set
    suspected: str | None
    experiment: Experiment | None
    ranking: tuple[Candidate, ...]


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
    held = [c for c in ranking if _holds(state, c)]
    strong = [c for c in held if matters(c)]
    strange = held[:1] if held and strong[:1] != held[:1] else []  # explains more than any name
    if strong and not any(_rules_out(c, strong[0]) for c in strange):
        ranking, rivals = against(state, strong[0], ranking)
        return (
            _of_the_gain(state, ranking, sensor_known_good)
            or _at_fault(state, (strong[0], *rivals), ranking, sensor_known_good)
            or _of_effects(strong[0], rivals, ranking, more)
        )
    return (
        _of_the_gain(state, ranking, sensor_known_good)
        or _at_fault(state, (), ranking, sensor_known_good)
        or Outcome(_nothing(state, added, strange), (), None, None, ranking)
    )


def _holds(state: State, candidate: Candidate) -> bool:
    """Whether a candidate's gain is more than chance: even over blocks, or large and never lost."""
    if candidate.score < candidate.needed:
        return False
    if candidate.t >= T_LEAST:
        return True
    after = scoring.deviance(candidate.fit, state.case.blocks)
    return _is_large(candidate) and scoring.win(after, state.deviance) > WIN_OF_FEW


def _rules_out(strange: Candidate, best: Candidate) -> bool:
    """Whether what cannot be, or is too small, explains more than the best that can be."""
    return not strange.physical or best.score < EQUAL * strange.score


def _is_large(candidate: Candidate) -> bool:
    """Whether the gain is far more than healthy drives give, if only in some blocks."""
    return candidate.score > FEW * candidate.needed


def _of_effects(
    best: Candidate, rivals: Sequence[Candidate], ranking: tuple[Candidate, ...], more: bool
) -> Outcome:
    """Return the name, or several that explain as much; a fault that explains little is neither."""
    if best.kind == "sensor fault":
        return Outcome("unknown_effect", (), None, None, ranking)
    others = [c for c in rivals if c.kind == "effect"]
    parts = more and all((c.adequacy or 0.0) < ADEQUATE for c in (best, *others))
    if others and not parts:
        among = (best, *others)[:AMBIGUOUS_MOST]
        return Outcome("ambiguous", among, None, separate(best.fit, others[0].fit), ranking)
    return Outcome("named", (best,), None, None, ranking)


def _nothing(state: State, added: Sequence[Candidate], strange: Sequence[Candidate]) -> Verdict:
    """Tell a gap that no candidate explains from no gap.

    strange : what explains more than any name, with constants that the effect cannot have
    """
    if not added and any(not c.physical for c in strange):
        return "unknown_effect"
    _, gains = scoring.left(state.current, state.roof, state.case.blocks)
    ceiling = scoring.score(gains, np.zeros_like(gains))
    share = ceiling.gain / state.deviance.sum()
    unknown = share > CEILING_SHARE and ceiling.t > CEILING_T and not added
    return "unknown_effect" if unknown else "no_gap"


def _enough(fault: Candidate) -> bool:
    """Whether a sensor fault explains half of what can be explained."""
    return fault.adequacy is None or fault.adequacy >= FAULT_ADEQUATE


def _at_fault(
    state: State,
    strong: Sequence[Candidate],
    ranking: tuple[Candidate, ...],
    sensor_known_good: bool,
) -> Outcome | None:
    """Suspect the sensor if a fault explains about as much, something began, or the base moved."""
    if sensor_known_good:
        return None
    words = next((c.name for c in strong if c.kind == "sensor fault" and _enough(c)), None)
    looked_at = strong[:1] or [c for c in ranking[:RANKED_CLOSELY] if _is_large(c)]
    for candidate in () if words else looked_at:
        if strong and getattr(candidate.fit.terms[-1], "varies", False):
            continue
        began = guards.onset_s(state.case, state.current, candidate.fit)
        if began is not None:
            words = f"it begins in {began[0]} at {began[1]:.0f} s"
    rivals = [c for c in ranking if c.kind == "sensor fault" or c.name in GAIN_CLASS]
    least = RIVAL_SCORE * ranking[0].score
    felt = not strong and any(
        c.score >= least and (_is_large(c) or _holds(state, c)) for c in rivals
    )
    if words is None and felt and (shift := _shift(state)) is not None:
        words = f"{shift} left its healthy reference"
    if words is None:
        return None
    return Outcome("sensor_fault_suspected", (), words, None, ranking)


def _shift(state: State) -> str | None:
    """Return in words how the base alone, refitted, left its reference; None if it did not."""
    prior = state.case.prior
    if prior is None or state.current.terms:
        return None
    free = replace(state.case, prior=Prior(prior.mean, FREE), fixed=None, shrinks=())
    return guards.shifted(prior.mean, fit(free, (), [state.current]).base)


def _hides_the_gain(state: State, best: Candidate, ranking: Sequence[Candidate]) -> bool:
    """Whether a factor or offset explains more than ``best`` if drives' own offsets are left in.

    Healthy drives differ in fuel and weather, so an offset is integrated out of every drive. A
    large one of all drives then shows in its traces only, which look like something else.
    """
    whole = replace(state.case, shrinks=())

    def alone(candidate: Candidate) -> tuple[FloatArray, Fit]:
        found = fit(whole, candidate.fit.terms, [candidate.fit])
        return scoring.deviance(found, whole.blocks), found

    own, _ = alone(best)
    for candidate in (c for c in ranking if c.name in GAIN_CLASS):
        deviance, found = alone(candidate)
        offset = float(np.abs(found.parameters[-1]).max())
        size = offset * (GAIN_OF_ETHANOL if candidate.name == GAIN_CLASS[0] else 1.0)
        if size > OFFSETS * state.offset_phi and scoring.win(deviance, own) >= WIN:
            return True
    return False


def _of_the_gain(
    state: State, ranking: tuple[Candidate, ...], sensor_known_good: bool
) -> Outcome | None:
    """Suspect the sensor where the best candidate is a factor on the mixture or an offset.

    A biased sensor in the control loop looks like another fuel: the controller makes the reading
    right, and what tells the two apart is smaller than what the base misses.
    """
    best = ranking[0]
    if not (_is_large(best) or _holds(state, best)) or _shift(state) != GAIN_WORDS:
        return None
    if best.name not in GAIN_CLASS and not _hides_the_gain(state, best, ranking):
        return None
    effect = [c for c in ranking if c.name == GAIN_CLASS[0]]
    if sensor_known_good and effect:
        return Outcome("named", (effect[0],), None, None, ranking)
    words = "a factor on the mixture (ethanol, humidity, slope errors) or a biased sensor"
    return Outcome("sensor_fault_suspected", (), words, None, ranking)
