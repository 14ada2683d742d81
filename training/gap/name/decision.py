"""The conclusion of one step: a name, several, an unknown effect, no gap, or the sensor.

It is read off the probabilities of all hypotheses. If no gap or another cause is likeliest, that is
the answer. Else it is the fewest candidates that hold 95 % of all candidates' probability: a sensor
fault among them is suspected, of several effects none is named, nor is one with an impossible sign.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from monitor.base.types import FloatArray
from training.gap.config import CONFIG
from training.gap.name.next_drives import next_drives
from training.gap.name.onset import onset_s
from training.gap.name.posterior import NONE, ONSET, UNKNOWN, Posterior, likely, posterior
from training.gap.name.ranking import RANKED_CLOSELY, rank
from training.gap.name.verdict import Candidate, NextDrives, Verdict
from training.greybox.effects import Effect
from training.greybox.fit.case import Term
from training.healthy.base_state import BaseState
from training.jobs import Progress

AMBIGUOUS_MOST: Final = CONFIG.inputs.effects_max
BIASED: Final = "biased"  # of a sensor in the control loop: the controller makes its reading right
GAIN_SUSPECTED: Final = (
    "a factor on the mixture (ethanol, humidity, slope errors) or a biased sensor"
)


@dataclass(frozen=True, slots=True)
class StepOutcome:
    """The conclusion of a step and its ranking."""

    verdict: Verdict
    ranking: tuple[Candidate, ...]  # best first
    best: tuple[Candidate, ...] = ()  # named, ambiguous, reversed, or effects alike to the fault
    suspected: str | None = None
    fault: Candidate | None = None  # suspected, as it was fitted; None of an onset
    experiment: NextDrives | None = None
    posterior: Posterior = field(default_factory=dict)
    part: Candidate | None = None  # effect that leads, but explains too little by itself

    @property
    def lead(self) -> Candidate | None:
        """Return the effect on top of which another may be looked for."""
        first = self.best[0] if self.verdict in ("named", "ambiguous") else self.part
        return None if first and first.is_reversed else first


def step(
    state: BaseState,
    candidates: Sequence[Term],
    whole: FloatArray,
    sensor_known_good: bool,
    progress: Progress,
) -> StepOutcome:
    """Return the outcome of one forward step; whole : deviance (n_blocks,) before the first."""
    ranking = rank(state, candidates, progress)
    odds = posterior(state, ranking, whole)
    by_label = {c.label: c for c in ranking}
    found = [by_label[name] for name in likely({name: odds[name] for name in by_label})]
    among = found if found and odds[found[0].label] > max(odds[NONE], odds[UNKNOWN]) else []
    outcome = None if sensor_known_good else _at_fault(state, ranking, among, odds)
    return outcome or _of_effects(state, ranking, among, odds)


def _of_effects(
    state: BaseState, ranking: tuple[Candidate, ...], among: Sequence[Candidate], odds: Posterior
) -> StepOutcome:
    """Return the name, several effects, or whether there is a gap of another cause."""
    if not among:
        if odds[NONE] >= odds[UNKNOWN]:
            return StepOutcome("no_gap", ranking, posterior=odds)
        first = ranking[0]
        may_lead = first.kind == "effect" and first.merit.is_large
        part = first if may_lead else None
        return StepOutcome("unknown_effect", ranking, posterior=odds, part=part)
    best = tuple(among[:AMBIGUOUS_MOST])
    experiment = next_drives(state.case, best)
    one: Verdict = "unknown_effect" if best[0].is_reversed else "named"
    verdict: Verdict = "ambiguous" if len(best) > 1 else one
    return StepOutcome(verdict, ranking, best=best, experiment=experiment, posterior=odds)


def _at_fault(
    state: BaseState, ranking: tuple[Candidate, ...], among: Sequence[Candidate], odds: Posterior
) -> StepOutcome | None:
    """Suspect the sensor if a fault explains about as much, or if something began."""
    suspicion = StepOutcome("sensor_fault_suspected", ranking, posterior=odds)
    faults = [c for c in among if c.kind == "sensor fault"]
    if among and isinstance(among[0].term, Effect) and among[0].term.gain_class:
        return replace(suspicion, best=(among[0],), suspected=GAIN_SUSPECTED, fault=among[0])
    if faults:
        fault = faults[0]
        words = GAIN_SUSPECTED if fault.name == BIASED else fault.name
        alike = tuple(
            c for c in ranking if c.kind == "effect" and (c in among or fault.name in c.like)
        )
        return replace(suspicion, best=alike[:AMBIGUOUS_MOST], suspected=words, fault=fault)
    looked_at = among[:1] or [c for c in ranking[:RANKED_CLOSELY] if c.merit.is_large]
    for candidate in looked_at:
        if among and getattr(candidate.term, "varies", False):
            continue
        began = onset_s(state.case, state.current, candidate.fit)
        if began is not None:
            moved = {candidate.label} if among else {NONE, UNKNOWN}
            began_p = sum(odds[name] for name in moved)
            odds = {**odds, **dict.fromkeys(moved, 0.0), ONSET: began_p}
            words = f"it begins in {began[0]} at {began[1]:.0f} s"
            return replace(suspicion, suspected=words, posterior=odds)
    return None
