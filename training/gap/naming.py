"""Which effect explains the gap between a base model and a vehicle, and whether one may say so.

Every effect of the library, and every gradual sensor fault as a rival, is fitted together with the
base's constants and scored on held-out blocks. A name is given only if the score is far above what
healthy drives show against each other, most of what can be explained at all is explained, no rival
is about as good, and nothing speaks for the sensor.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from monitor.errors import RecordingError
from training.chain import Constants
from training.gap import guards, scoring
from training.gap import healthy as healthy_drives
from training.gap.begin import FREE, begin
from training.gap.drives import Drive
from training.gap.effects import ALL
from training.gap.fitting import Case, Prior, Term, fit, held_out_rmse
from training.gap.healthy import Healthy
from training.gap.manoeuvres import Experiment, separate
from training.gap.ranking import (
    CEILING_SHARE,
    RANKED_CLOSELY,
    WIN,
    Progress,
    State,
    against,
    matters,
    rank,
)
from training.gap.sensor_faults import FAULTS
from training.gap.verdict import Candidate, Naming, Verdict

SCORE_LEAST: Final = 80.0
T_LEAST: Final = 3.0
SCORE_OF_FEW: Final = 250.0  # for an effect that lives in few blocks, where t is small
WIN_OF_FEW: Final = 0.99  # of resampled blocks, over no effect
AMBIGUOUS_MOST: Final = 3
ADEQUATE: Final = 0.85
CEILING_T: Final = 3.5
GAIN_WORDS: Final = "the gain"
GAIN_CLASS: Final = ("ethanol", "biased")  # a factor on the mixture, and what looks like it


def name(
    drives: Sequence[Drive],
    healthy: Sequence[Drive] | None = None,
    reference: Constants | None = None,
    *,
    steps: int = 1,
    sensor_known_good: bool = False,
    progress: Progress = lambda _: None,
) -> Naming:
    """Return which effect, if any, explains the drives.

    drives : recordings of one vehicle with the gap
    healthy : recordings of the same vehicle on which the base was accepted; without them every
        weakness of the base itself is part of the gap
    reference : base constants of the healthy vehicle, if ``healthy`` is not given
    steps : effects to add at most, one after the other
    sensor_known_good : leave the sensor's faults out
    progress : is told what goes on
    Raises RecordingError if there is no drive or their sample periods differ.
    """
    every = (*drives, *(healthy or ()))
    if not drives or len({round(d.period_s, 6) for d in every}) != 1:
        raise RecordingError("the gap workflow wants drives of one sample period, at least one")
    progress("base")
    known = healthy_drives.learn(healthy, reference or Constants()) if healthy else None
    state = begin(drives, known, known.base if known else reference)
    skipped = {
        e.name: missing
        for e in ALL
        if (missing := tuple(n for n in e.needs if any(n not in d.signals for d in drives)))
    }
    candidates: list[Term] = [e for e in ALL if e.name not in skipped]
    if not sensor_known_good and state.case.prior is not None:
        candidates += FAULTS
    first, added = state, list[Candidate]()
    warnings = _doubts(state.case, known)
    outcome = _Outcome("no_gap", (), None, None, ())
    for _ in range(steps):
        outcome = _step(state, candidates, added, sensor_known_good, progress)
        warnings += outcome.warnings
        if outcome.verdict != "named":
            break
        added.append(outcome.best[0])
        candidates = [c for c in candidates if c.name != added[-1].name]
        state = replace(
            state,
            current=added[-1].fit,
            deviance=scoring.deviance(added[-1].fit, state.case.blocks),
        )
    return _answer(first, state, outcome, added, skipped, known, reference, warnings)


@dataclass(frozen=True, slots=True)
class _Outcome:
    verdict: Verdict
    best: tuple[Candidate, ...]  # the named one, or the ambiguous set
    suspected: str | None
    experiment: Experiment | None
    ranking: tuple[Candidate, ...]
    warnings: tuple[str, ...] = ()


def _step(
    state: State,
    candidates: Sequence[Term],
    added: Sequence[Candidate],
    sensor_known_good: bool,
    progress: Progress,
) -> _Outcome:
    """Return the outcome of one forward step."""
    ranking = rank(state, candidates, progress)
    strong = [c for c in ranking if _holds(state, c) and matters(c)]
    if strong:
        ranking, rivals = against(state, strong[0], ranking)
        return (
            _of_the_gain(state, ranking, sensor_known_good)
            or _at_fault(state, (strong[0], *rivals), ranking, sensor_known_good)
            or _of_effects(strong[0], rivals, ranking)
        )
    return (
        _of_the_gain(state, ranking, sensor_known_good)
        or _at_fault(state, (), ranking, sensor_known_good)
        or _Outcome(_nothing(state, added), (), None, None, ranking)
    )


def _holds(state: State, candidate: Candidate) -> bool:
    """Whether a candidate's gain is more than chance: even over blocks, or large and never lost."""
    if candidate.score < SCORE_LEAST:
        return False
    if candidate.t >= T_LEAST:
        return True
    after = scoring.deviance(candidate.fit, state.case.blocks)
    return candidate.score > SCORE_OF_FEW and scoring.win(after, state.deviance) > WIN_OF_FEW


def _of_effects(
    best: Candidate, rivals: Sequence[Candidate], ranking: tuple[Candidate, ...]
) -> _Outcome:
    """Return the name, several of them, or that none explains enough."""
    if best.adequacy is not None and best.adequacy < ADEQUATE:
        return _Outcome("unknown_effect", (), None, None, ranking)
    if rivals:
        among = (best, *rivals)[:AMBIGUOUS_MOST]
        return _Outcome("ambiguous", among, None, separate(best.fit, rivals[0].fit), ranking)
    return _Outcome("named", (best,), None, None, ranking)


def _nothing(state: State, added: Sequence[Candidate]) -> Verdict:
    """Tell a gap that no candidate explains from no gap."""
    _, gains = scoring.left(state.current, state.roof, state.case.blocks)
    ceiling = scoring.score(gains, np.zeros_like(gains))
    share = ceiling.gain / state.deviance.sum()
    unknown = share > CEILING_SHARE and ceiling.t > CEILING_T and not added
    return "unknown_effect" if unknown else "no_gap"


def _at_fault(
    state: State,
    strong: Sequence[Candidate],
    ranking: tuple[Candidate, ...],
    sensor_known_good: bool,
) -> _Outcome | None:
    """Suspect the sensor if a fault explains about as much, something began, or the base moved."""
    if sensor_known_good:
        return None
    words = next((c.name for c in strong if c.kind == "sensor fault"), None)
    looked_at = strong[:1] or [c for c in ranking[:RANKED_CLOSELY] if c.score >= SCORE_LEAST]
    for candidate in () if words else looked_at:
        began = guards.onset_s(state.case, state.current, candidate.fit)
        if began is not None:
            words = f"it begins in {began[0]} at {began[1]:.0f} s"
    if words is None and not strong and (shift := _shift(state)) is not None:
        words = f"{shift} left its healthy reference"
    if words is None:
        return None
    return _Outcome("sensor_fault_suspected", (), words, None, ranking)


def _shift(state: State) -> str | None:
    """Return in words how the base alone, refitted, left its reference; None if it did not."""
    prior = state.case.prior
    if prior is None or state.current.terms:
        return None
    free = replace(state.case, prior=Prior(prior.mean, FREE), shrinks=())
    return guards.shifted(prior.mean, fit(free, (), [state.current]).base)


def _of_the_gain(
    state: State, ranking: tuple[Candidate, ...], sensor_known_good: bool
) -> _Outcome | None:
    """Tell a factor on the mixture from a biased sensor, where the best candidate is either.

    What varies from drive to drive is left in, because gain and span of the reading differ for the
    two: a factor leaves the span as it was.
    """
    if ranking[0].name not in GAIN_CLASS or _shift(state) != GAIN_WORDS:
        return None
    whole = replace(state.case, shrinks=())
    by_name = {c.name: c for c in ranking if c.name in GAIN_CLASS}
    own = {
        name: scoring.deviance(fit(whole, c.fit.terms, [c.fit]), whole.blocks)
        for name, c in by_name.items()
    }
    effect, fault = GAIN_CLASS
    if effect in own and (fault not in own or scoring.win(own[effect], own[fault]) >= WIN):
        return _Outcome("named", (by_name[effect],), None, None, ranking)
    if sensor_known_good:
        return None
    return _Outcome("sensor_fault_suspected", (), ranking[0].name, None, ranking)


def _doubts(case: Case, known: Healthy | None) -> list[str]:
    doubts = []
    if known is None:
        doubts.append(
            "no healthy recordings: a weakness of the base itself cannot be told from an effect"
        )
    if case.prior is None:
        doubts.append("no reference: a shift of gain, dead time or lag cannot be seen")
    return doubts


def _answer(
    first: State,
    last: State,
    outcome: _Outcome,
    added: Sequence[Candidate],
    skipped: dict[str, tuple[str, ...]],
    known: Healthy | None,
    reference: Constants | None,
    warnings: Sequence[str],
) -> Naming:
    verdict: Verdict = "named" if added else outcome.verdict
    if outcome.verdict == "sensor_fault_suspected":
        verdict, added = outcome.verdict, ()
    base = known.base if known else reference
    alone = fit(replace(first.case, prior=Prior(base, FREE)), (), [first.current]) if base else None
    shift = Constants(*(np.array(alone.base) - np.array(base)).tolist()) if alone else None
    _, gains = scoring.left(first.current, first.roof, first.case.blocks)
    return Naming(
        verdict,
        tuple(added) or outcome.best,
        outcome.suspected,
        outcome.ranking,
        skipped,
        last.current.base,
        base,
        shift,
        held_out_rmse(first.case, first.current),
        held_out_rmse(last.case, last.current) if added else None,
        scoring.floor_phi(first.case, first.current),
        float(gains.sum() / first.deviance.sum()),
        outcome.experiment,
        tuple(warnings),
    )
