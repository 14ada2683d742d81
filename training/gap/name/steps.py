"""Steps of the naming: effects one after the other, each on top of those before it."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Final

from training.gap.name.decision import StepOutcome, step
from training.gap.name.posterior import Posterior, on_top
from training.gap.name.verdict import Candidate, Round
from training.greybox.effects import Effect
from training.greybox.fit.case import Term
from training.greybox.fit.joint import held_out_rmse
from training.healthy import scoring
from training.healthy.base_state import BaseState
from training.jobs import Progress

NOTHING: Final = ("no_gap", "unknown_effect")


@dataclass(frozen=True, slots=True)
class Advance:
    """All steps: one round per effect that a step named, and the outcome of the last step."""

    last: BaseState  # with the effects of all rounds
    outcome: StepOutcome
    rounds: tuple[Round, ...]
    first: tuple[Candidate, ...]  # the ranking of the first step
    posterior: Posterior  # of all steps together
    beside: tuple[Candidate, ...] = ()  # see ``Answer.beside``


@dataclass(frozen=True, slots=True)
class _Path:
    """The rounds so far; ``states`` holds the start and the state after each."""

    states: list[BaseState]
    rounds: list[Round] = field(default_factory=list)

    @property
    def state(self) -> BaseState:
        return self.states[-1]

    @property
    def effects(self) -> tuple[Candidate, ...]:
        return tuple(r.effect for r in self.rounds)

    def left(self, candidates: Sequence[Term]) -> list[Term]:
        """Return the candidates without those of the rounds."""
        return [c for c in candidates if c.name not in [each.name for each in self.effects]]

    def take(self, effect: Candidate, ranking: tuple[Candidate, ...]) -> None:
        """Add a round."""
        self.rounds.append(Round(effect, held_out_rmse(self.state.case, effect.fit), ranking))
        self.states.append(self.state.with_fit(effect.fit))

    def drop(self) -> None:
        """Take the last round back."""
        self.rounds.pop()
        self.states.pop()


def advance(
    state: BaseState,
    candidates: Sequence[Term],
    steps: int,
    sensor_known_good: bool,
    progress: Progress,
) -> Advance:
    """Return the steps until one has nothing to go on with, or as many as were asked for.

    Where nothing is found on top of an effect, what was said before it holds.
    """
    path, told, whole = _Path([state]), list[StepOutcome](), state.deviance
    while len(told) < steps:
        left = path.left(candidates)
        told.append(step(path.state, left, whole, sensor_known_good, progress))
        lead, is_named = told[-1].lead, told[-1].verdict == "named"
        if lead is None or (len(told) == steps and not is_named):
            break
        path.take(lead, told[-1].ranking)
    first, last = told[0].ranking, told[-1].ranking
    while len(told) > 1 and told[-1].verdict in NOTHING:
        before = told[-2].verdict
        told.pop()
        if before != "named":
            path.drop()
    outcome, beside = told[-1], tuple[Candidate, ...]()
    if path.rounds and outcome.verdict == "ambiguous":
        before = told[-2].verdict
        if before == "ambiguous":
            # Any of the several may be all that there is.
            path.drop()
            told.pop()
            outcome = told[-1]
        elif before == "named":
            outcome, beside = replace(outcome, verdict="named"), outcome.best
    if path.rounds:
        outcome = replace(outcome, ranking=last)
    if outcome.verdict == "sensor_fault_suspected":
        beside = path.effects
        if len(told) < steps:
            beside += _on_top(path.state, outcome, path.left(candidates), progress)
    rounds, odds = tuple(path.rounds), _posterior(told, path)
    return Advance(path.state, outcome, rounds, first, odds, beside)


def _posterior(told: Sequence[StepOutcome], path: _Path) -> Posterior:
    """Return the probabilities of all steps together, of pairs by both names.

    A rival of an effect is held against both effects, too, of which the second has to explain as
    much more than the rival as it needs.
    """
    odds, before = told[0].posterior, ""
    for (first, then), effect in zip(pairwise(told), path.effects, strict=False):
        best = then.ranking[0]
        both = best.left + best.merit.needed / len(best.left)
        beaten = {before + c.label: scoring.win(both, c.left) for c in first.ranking}
        odds = on_top(odds, before + effect.name, then.posterior, beaten)
        before += f"{effect.name}+"
    return odds


def _on_top(
    state: BaseState, suspicion: StepOutcome, candidates: Sequence[Term], progress: Progress
) -> tuple[Candidate, ...]:
    """Return the effect that a step names where the suspected fault is taken for certain."""
    fault = suspicion.fault
    if fault is None:
        return ()
    effects = [
        c for c in candidates if isinstance(c, Effect) and fault.name not in (c.name, *c.like)
    ]
    found = step(state.with_fit(fault.fit), effects, state.deviance, True, progress)
    return found.best if found.verdict == "named" else ()
