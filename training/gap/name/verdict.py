"""The result of naming: verdict, effects with their constants, ranking, warnings."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from training.gap.name.manoeuvres import Experiment
from training.greybox.chain import Constants
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.fit.joint import Fit

Verdict = Literal["named", "no_gap", "ambiguous", "unknown_effect", "sensor_fault_suspected"]


@dataclass(frozen=True, slots=True)
class Candidate:
    """One effect or sensor fault and how well it explains the gap."""

    name: str
    kind: Literal["effect", "sensor fault"]
    says: str
    tag: str  # physics, fault-like or either; sensor for a sensor fault
    like: tuple[str, ...]  # what it cannot be told from by construction
    parameters: Mapping[str, float]
    standard_errors: Mapping[str, float]
    units: Mapping[str, str]
    score: float  # fall of the deviance on held-out blocks
    needed: float  # score below which it is nothing new, by what healthy drives give it
    t: float  # of the signed square roots of the blocks' falls
    physical: bool  # whether its constants are such as the effect can have
    adequacy: float | None  # of what can be explained at all; None if not worth asking
    win: float | None  # how often resampled blocks prefer the best to this; None for the best
    fit: Fit

    def model_effect(self) -> ModelEffect:
        """Return the effect as a part of a model; raises ModelError for a sensor fault."""
        return ModelEffect(
            name=self.name,
            says=self.says,
            tag=self.tag,
            like=self.like,
            parameters=self.parameters,
            standard_errors=self.standard_errors,
            units=self.units,
        )


@dataclass(frozen=True, slots=True)
class Round:
    """One named effect and the ranking it was chosen from."""

    effect: Candidate
    rmse: float  # phi, on held-out blocks, with it
    ranking: tuple[Candidate, ...]


@dataclass(frozen=True, slots=True)
class Naming:
    """The answer of the workflow's second step."""

    verdict: Verdict
    skipped: Mapping[str, tuple[str, ...]]  # effect → signals that are missing
    rmse_before: float  # phi, on held-out blocks
    noise_floor: float  # phi, what the ceiling leaves on held-out blocks
    explained_share: float  # of the whitened deviance, by the ceiling
    warnings: tuple[str, ...]
    effects: tuple[Candidate, ...] = ()  # named, or the ambiguous set
    suspected: str | None = None  # the sensor fault, or the onset
    ranking: tuple[Candidate, ...] = ()  # of the last step, best first
    base: Constants | None = None  # with the named effects; None where no effect could be tried
    reference: Constants | None = None
    base_shift: Constants | None = None  # of the base refitted alone, against the reference
    rmse_after: float | None = None
    experiment: Experiment | None = None
    rounds: tuple[Round, ...] = ()  # of the named effects, in the order found
    indistinguishable: tuple[Candidate, ...] = ()  # effects that the suspected fault looks like
