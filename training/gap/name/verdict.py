"""The result of naming: verdict, effects with their constants, ranking, warnings."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from monitor.base.counts import duration
from monitor.base.types import FloatArray
from training.greybox.chain import Constants
from training.greybox.effects import Effect
from training.greybox.effects.empirical import is_empirical
from training.greybox.fit.case import Term
from training.greybox.fit.joint import JointFit
from training.pages.numbers import percent

Verdict = Literal["named", "no_gap", "ambiguous", "unknown_effect", "sensor_fault_suspected"]
Kind = Literal["effect", "empirical", "sensor fault"]


@dataclass(frozen=True, slots=True)
class Merit:
    """How well a candidate explains the gap."""

    score: float  # fall of the deviance on held-out blocks
    needed: float  # score from which it exceeds its score on healthy drives
    t: float  # of the signed square roots of the blocks' falls
    physical: bool  # whether the effect has the sign that it can have

    @property
    def is_large(self) -> bool:
        """Return whether the gain is more than healthy drives give, if only in some blocks."""
        return self.score >= self.needed


@dataclass(frozen=True, slots=True)
class Candidate:
    """One effect or sensor fault, fitted on the base and the effects so far."""

    fit: JointFit  # the candidate is its last term
    merit: Merit
    left: FloatArray  # (n_blocks,) deviance of held-out blocks with it

    @property
    def term(self) -> Term:
        """Return the effect or sensor fault."""
        return self.fit.terms[-1]

    @property
    def name(self) -> str:
        """Return the name of the effect or sensor fault."""
        return self.term.name

    @property
    def is_reversed(self) -> bool:
        """Return whether the effect acts in the direction that it cannot have by itself."""
        return not self.merit.physical

    @property
    def label(self) -> str:
        """Return the hypothesis: the name, and whether the effect is reversed."""
        return f"{self.name} reversed" if self.is_reversed else self.name

    @property
    def says(self) -> str:
        """Return the name and what it is, as the end of a sentence."""
        if not self.is_reversed:
            return f"{self.name} ({self.term.says})"
        return f"{self.name} in the other direction (look at {self.look_at})"

    @property
    def look_at(self) -> str:
        """Return causes of an effect in the other direction, as the end of a sentence."""
        opposite = f"what does the opposite of: {self.term.says}"
        return getattr(self.term, "look_at", "") or opposite

    @property
    def kind(self) -> Kind:
        """Return whether the candidate is an effect, a formula of signals or a sensor fault."""
        if is_empirical(self.name):
            return "empirical"
        return "effect" if isinstance(self.term, Effect) else "sensor fault"

    @property
    def tag(self) -> str:
        """Return physics, fault-like or either; sensor for a sensor fault."""
        return self.term.tag if isinstance(self.term, Effect) else "sensor"

    @property
    def like(self) -> tuple[str, ...]:
        """Return the names from which the effect cannot be told by construction."""
        return self.term.like if isinstance(self.term, Effect) else ()

    @property
    def parameters(self) -> dict[str, float]:
        """Return the fitted constants by name."""
        return self._by_name(self.fit.parameters[-1].tolist())

    @property
    def standard_errors(self) -> dict[str, float]:
        """Return the standard errors of the constants by name."""
        return self._by_name(self.fit.standard_errors[-1].tolist())

    def _by_name(self, values: list[float]) -> dict[str, float]:
        return dict(zip((p.name for p in self.term.parameters), values, strict=True))


@dataclass(frozen=True, slots=True)
class Round:
    """One named effect and the ranking it was chosen from."""

    effect: Candidate
    rmse: float  # phi, on held-out blocks, with it
    ranking: tuple[Candidate, ...]


class NextDrives(NamedTuple):
    """Driving like the present, after which one candidate may be named."""

    seconds: float
    name: str
    probability: float  # that it is named, if no other explanation comes up

    def __str__(self) -> str:
        """Return it as the end of a sentence."""
        return (
            f"{duration(60.0 * round(self.seconds / 60.0))} more like these, in several "
            f"recordings; {self.name} is then named with a probability of at most "
            f"{percent(self.probability)}"
        )


@dataclass(frozen=True, slots=True)
class Answer:
    """The conclusion beside the verdict."""

    effects: tuple[Candidate, ...] = ()  # named, the ambiguous set, reversed, terms of a formula
    suspected: str | None = None  # the sensor fault, or the onset; one that bars a formula, too
    indistinguishable: tuple[Candidate, ...] = ()  # effects that the suspected fault looks like
    beside: tuple[Candidate, ...] = ()  # one of these after a name, all beside a suspected fault
    experiment: NextDrives | None = None  # to tell an ambiguous set apart


@dataclass(frozen=True, slots=True)
class Trials:
    """The candidates that were tried."""

    ranking: tuple[Candidate, ...] = ()  # of the last step, best first
    rounds: tuple[Round, ...] = ()  # of the named effects, in the order of naming
    skipped: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # effect → missing signals


@dataclass(frozen=True, slots=True)
class Base:
    """The chain's constants under the effects."""

    constants: Constants  # with the named effects
    reference: Constants | None  # of the healthy vehicle
    shift: Constants | None  # of the base refitted alone, against the reference


@dataclass(frozen=True, slots=True)
class BlockError:
    """The error on held-out blocks, RMS in phi."""

    before: float
    after: float | None  # with the named effects
    floor: float  # left by the ceiling, the most flexible model
    explained_share: float  # of the whitened deviance, by the ceiling


@dataclass(frozen=True, slots=True)
class Naming:
    """The answer of the workflow's second step."""

    verdict: Verdict
    answer: Answer
    trials: Trials
    base: Base | None  # None where no effect could be tried
    error: BlockError
    warnings: tuple[str, ...]
    posterior: Mapping[str, float] = field(default_factory=dict)  # hypothesis → probability
