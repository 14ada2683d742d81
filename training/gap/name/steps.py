"""Steps of the naming: effects one after the other, each on top of those before it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from training.gap.name import scoring
from training.gap.name.decision import Outcome, step
from training.gap.name.ranking import State
from training.gap.name.verdict import Candidate, Round
from training.greybox.effects import Effect
from training.greybox.fit.case import Term
from training.greybox.fit.held_out import held_out_rmse
from training.jobs.checkpoints import Progress


@dataclass(frozen=True, slots=True)
class Advance:
    """All steps: one round per effect that a step named, and the outcome of the last step."""

    last: State  # with the effects of all rounds
    outcome: Outcome
    rounds: tuple[Round, ...]
    warnings: tuple[str, ...]
    first: tuple[Candidate, ...]  # the ranking of the first step
    beside: tuple[Candidate, ...] = ()  # see ``Answer.beside``


def advance(
    state: State,
    candidates: Sequence[Term],
    steps: int,
    sensor_known_good: bool,
    progress: Progress,
) -> Advance:
    """Return the steps until one names nothing, or until there are as many as were asked for."""
    outcome, rounds, warnings = Outcome("no_gap", ()), list[Round](), list[str]()
    before, named = state, outcome
    for number in range(steps):
        more = number + 1 < steps
        added = [r.effect for r in rounds]
        outcome = step(state, candidates, added, sensor_known_good, progress, more=more)
        if outcome.verdict != "named":
            break
        before, named, best = state, outcome, outcome.best[0]
        rounds.append(Round(best, held_out_rmse(state.case, best.fit), outcome.ranking))
        if best.tag == "fault-like" and not sensor_known_good:
            warnings.append(f"{best.name} may be a fault: add it only if it is known not to be")
        candidates = [c for c in candidates if c.name != best.name]
        state = _with(state, best)
    first = rounds[0].ranking if rounds else outcome.ranking
    if len(named.best) > 1 and outcome.verdict != "sensor_fault_suspected":
        # Nothing was found beside the best of several: any of them may be all that there is.
        state, outcome, rounds = before, replace(named, verdict="ambiguous"), rounds[:-1]
    beside = outcome.best if rounds and outcome.verdict == "ambiguous" else ()
    if outcome.verdict == "sensor_fault_suspected":
        beside = tuple(r.effect for r in rounds)
        if len(rounds) + 1 < steps:
            beside += _on_top(state, outcome, candidates, progress)
    return Advance(state, outcome, tuple(rounds), tuple(warnings), first, beside)


def _with(state: State, added: Candidate) -> State:
    """Return the start of the next step, with a candidate as part of the base."""
    deviance = scoring.deviance(added.fit, state.case.blocks)
    return replace(state, current=added.fit, deviance=deviance)


def _on_top(
    state: State, suspicion: Outcome, candidates: Sequence[Term], progress: Progress
) -> tuple[Candidate, ...]:
    """Return the effect that a step names where the suspected fault is taken for certain."""
    fault = suspicion.fault
    if fault is None:
        return ()
    effects = [
        c for c in candidates if isinstance(c, Effect) and fault.name not in (c.name, *c.like)
    ]
    found = step(_with(state, fault), effects, (fault,), True, progress)
    return found.best if found.verdict == "named" else ()
