"""The gap workflow from recordings to a new model: localise, name, add, verify.

The name is looked for in all recordings. The constants in the new model come from those that are
not held out, and what is said of the new model from those that are.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from monitor.errors import UsageError
from monitor.faults import Fault
from monitor.model_card import ModelCard
from training.chain import Constants
from training.gap import (
    accepted,
    add_greybox,
    add_narx,
    base,
    healthy,
    learn_reference,
    located,
    mixed,
    reference_card,
    usable,
)
from training.gap.added import Added, uncertain
from training.gap.begin import begin
from training.gap.compared import Compared
from training.gap.describe import describe
from training.gap.detection import FAULTS
from training.gap.drives import Drive
from training.gap.fitting import fit
from training.gap.healthy import Healthy
from training.gap.localise import Findings, localise
from training.gap.naming import name
from training.gap.predicted import predicted_phi
from training.gap.result import ModelFile, Result, Step, of_recording
from training.gap.stages import Stages
from training.gap.verdict import Naming
from training.gap.verified import Verified
from training.gap.verify import verify
from training.recordings import Recording

Progress = Callable[[str], None]
HELD_OUT_EVERY: Final = 3  # recordings, of which the last is held out
NEW_MODEL: Final = "model.onnx"
FORMS: Final = {
    "greybox": "inside the chain, where it acts on the mixture's way",
    "output": "beside the network: its output plus the chain with the effect less that without",
    "input": "as one more input of the network, trained anew",
}
NO_USE: Final = (
    "what was named is not added: with it the model predicts the recordings of the fit no better, "
    "it follows the effect already"
)
WORSE: Final = 1.02  # of the RMSE, up to which a form counts as no worse


@dataclass(frozen=True, slots=True)
class Options:
    """What the user chose."""

    steps: int = 1
    sensor_known_good: bool = False
    add: tuple[str, ...] = ()  # effects that may be faults, and are known to be none
    retrain_minutes: float = 0.0  # for a network with the effect as an input; 0 is none
    faults: tuple[Fault, ...] = FAULTS  # put on for verifying; none leaves the monitor out
    localise: bool = True


@dataclass(frozen=True, slots=True)
class Given:
    """What the workflow works on."""

    model: Path
    recordings: Sequence[Recording]
    healthy: Sequence[Recording] = ()
    verify: Sequence[Recording] = ()  # seen by nothing but the verification

    @property
    def roles(self) -> dict[str, Sequence[Recording]]:
        """Return the recordings by what the command calls them."""
        return {"RECORDING": self.recordings, "--healthy": self.healthy, "--verify": self.verify}


def investigate(
    given: Given,
    out: Path,
    options: Options,
    *,
    known: Healthy | None = None,
    stages: Stages | None = None,
    progress: Progress = lambda _: None,
) -> Result:
    """Return what was found; a new model, if there is one, is ``out``/model.onnx.

    known : what ``accepted.learn`` made of the healthy recordings, if it is there already; without
        healthy recordings it is what the model's card says
    stages : where results of a run that was stopped are kept
    Raises RecordingError or ModelError if recordings or model cannot be used.
    """
    began_s, stages = time.monotonic(), stages or Stages()
    model, card = given.model, base.check(given.model)
    missing = usable.check_files(given.roles, card, model.name)
    if missing:
        every = (*given.recordings, *given.verify)
        return located.investigate(
            model, card, every, given.healthy, missing, sensor_known_good=options.sensor_known_good,
            progress=progress,
        )  # fmt: skip
    drives = base.drives_of(model, given.recordings)
    usable.check_long(drives, "new")
    usable.check_moving(drives)
    start = base.constants_of(card)
    doubts = usable.unlearned(given.recordings, given.healthy)
    if known is None and given.healthy:
        known = stages.done("healthy", lambda: _learn(given, start, progress))
    elif known is None:
        known, doubts = reference_card.known_of(card)
    reference = known.base if known else start
    found = stages.done("where", lambda: _localise(given, progress)) if options.localise else None
    naming = stages.done(
        "name",
        lambda: name(
            drives,
            known,
            reference if card.kind == base.GREYBOX else None,
            steps=options.steps,
            sensor_known_good=options.sensor_known_good,
            progress=progress,
        ),
    )
    wanted, warnings = _to_add(naming, options)
    doubts += usable.poor(card)
    doubts += mixed.warn(
        drives,
        mixed.chain_of(naming, reference),
        base.plain_drives_of(card, given.healthy),
    )
    fitted_to, held_out = _split(given)
    new, form, added = None, "", tuple[Added, ...]()
    if wanted:
        progress("adding")
        added = _refitted(given, fitted_to, naming, known, reference)
        new, form = _add(given, out / NEW_MODEL, card, added, reference, fitted_to, options)
        if new is None:
            added, warnings = (), [*warnings, NO_USE]
        elif card.kind == base.GREYBOX and known is not None and given.healthy:
            learn_reference.store(new, known, given.healthy)  # with which its constants go
    checked = None
    if held_out:
        checked = stages.done(
            "verify",
            lambda: verify(
                model, new, held_out, given.healthy, chain=reference, faults=options.faults,
                progress=progress,
            ),
        )  # fmt: skip
    return Result(
        ModelFile.of(model),
        tuple(map(of_recording, given.recordings)),
        tuple(map(of_recording, given.healthy)),
        tuple(map(of_recording, held_out)),
        found,
        naming,
        added,
        form,
        checked,
        new,
        _steps(naming),
        _unknown(naming, drives, known, reference),
        (*doubts, *warnings, *uncertain(added), *_of_verifying(checked, held_out)),
        options.sensor_known_good,
        time.monotonic() - began_s,
    )


def _learn(given: Given, start: Constants, progress: Progress) -> Healthy:
    drives = base.drives_of(given.model, given.healthy)
    usable.check_long(drives, "healthy")
    return accepted.learn(drives, start, progress)


def _localise(given: Given, progress: Progress) -> Findings:
    progress("localising")
    new, known = (
        [
            Compared.of(drive, phi)
            for drive, phi in zip(
                base.drives_of(given.model, each), predicted_phi(given.model, each), strict=True
            )
        ]
        for each in (given.recordings, given.healthy)
    )
    return localise(new, known)


def _to_add(naming: Naming, options: Options) -> tuple[bool, list[str]]:
    """Return whether what was named may be added, and what to say if not."""
    if naming.verdict != "named":
        return False, []
    allowed = set(options.add)
    withheld = [
        c.name
        for c in naming.effects
        if c.tag == "fault-like" and not options.sensor_known_good and c.name not in allowed
    ]
    if not withheld:
        return True, []
    names = " and ".join(withheld)
    return False, [
        f"{names} may be a fault of the vehicle and is not added: where it is known to be none, "
        f"say so with --add {' '.join(withheld)}"
    ]


def _split(given: Given) -> tuple[list[int], list[Recording]]:
    """Return which recordings the constants come from, and the recordings held out."""
    n = len(given.recordings)
    out = set() if given.verify else set(range(HELD_OUT_EVERY - 1, n, HELD_OUT_EVERY))
    if n == HELD_OUT_EVERY - 1 and not given.verify:
        out = {n - 1}
    fitted_to = [i for i in range(n) if i not in out]
    return fitted_to, [*given.verify, *(given.recordings[i] for i in sorted(out))]


def _refitted(
    given: Given,
    fitted_to: Sequence[int],
    naming: Naming,
    known: Healthy | None,
    reference: Constants,
) -> tuple[Added, ...]:
    """Return what was named with constants from those recordings alone.

    A network's own errors are what the constants have to suit, where healthy recordings tell which
    of them it makes anyway.
    """
    recordings = [given.recordings[i] for i in fitted_to]
    drives = base.drives_of(given.model, recordings)
    if given.healthy and base.check(given.model).kind != base.GREYBOX:
        drives = base.read_by(given.model, recordings)
        known = healthy.learn(base.read_by(given.model, given.healthy), reference)
    last = naming.effects[-1].fit
    state = begin(drives, known, reference)
    again = fit(state.case, last.terms, [last])
    added = []
    for candidate, values, errors in zip(
        naming.effects, again.parameters, again.standard_errors, strict=True
    ):
        names = list(candidate.parameters)
        added.append(
            Added.of(
                replace(
                    candidate,
                    parameters=dict(zip(names, values.tolist(), strict=True)),
                    standard_errors=dict(zip(names, errors.tolist(), strict=True)),
                )
            )
        )
    return tuple(added)


def _add(
    given: Given, out: Path, card: ModelCard, added: Sequence[Added], reference: Constants,
    fitted_to: Sequence[int], options: Options,
) -> tuple[Path | None, str]:  # fmt: skip
    """Write the new model in the form that predicts best; return it and the form.

    There is none if it predicts the recordings of the fit no better than the old one.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    recordings = [given.recordings[i] for i in fitted_to]
    drives = base.drives_of(given.model, recordings)
    ranges = {
        name: (
            float(min(np.min(d.signals[name]) for d in drives)),
            float(max(np.max(d.signals[name]) for d in drives)),
        )
        for name in drives[0].signals
        if all(name in d.signals for d in drives)
    }
    used = tuple(map(of_recording, recordings))
    if card.kind == base.GREYBOX:
        constants = None if reference == base.constants_of(card) else reference
        add_greybox.add(
            given.model, added, out, ranges=ranges, recordings=used, constants=constants,
            drives=drives,
        )  # fmt: skip
        return _if_better(given.model, out, recordings, FORMS["greybox"])
    add_narx.add(given.model, added, reference, out, ranges=ranges, recordings=used, drives=drives)
    if options.retrain_minutes <= 0.0:
        return _if_better(given.model, out, recordings, FORMS["output"])
    other = out.with_name("retrained.onnx")
    add_narx.retrain(
        given.model, added, reference, recordings, other, ranges=ranges,
        budget_minutes=options.retrain_minutes,
    )  # fmt: skip
    _, held_out = _split(given)
    beside, inside = (_rmse(each, held_out or recordings) for each in (out, other))
    if inside * WORSE < beside:
        other.replace(out)
        return out, f"{FORMS['input']} (RMSE {inside:.4f} against {beside:.4f} beside it)"
    other.unlink()
    form = f"{FORMS['output']} (RMSE {beside:.4f} against {inside:.4f} trained anew)"
    return _if_better(given.model, out, recordings, form)


def _if_better(
    old: Path, new: Path, recordings: Sequence[Recording], form: str
) -> tuple[Path | None, str]:
    if _rmse(new, recordings) < _rmse(old, recordings):
        return new, form
    new.unlink()
    return None, ""


def _rmse(model: Path, recordings: Sequence[Recording]) -> float:
    """Return the RMSE in phi on the scored samples of recordings."""
    squares = []
    for recording, phi in zip(recordings, predicted_phi(model, recordings), strict=True):
        (drive,) = base.drives_of(model, [recording])
        squares.append((phi - drive.phi_measured)[drive.scored] ** 2)
    return float(np.sqrt(np.concatenate(squares).mean()))


def _steps(naming: Naming) -> tuple[Step, ...]:
    first = Step("", naming.rmse_before)
    return (first, *(Step(r.effect.name, r.rmse, r.ranking) for r in naming.rounds))


def _unknown(
    naming: Naming, drives: Sequence[Drive], known: Healthy | None, reference: Constants
) -> str | None:
    if naming.verdict != "unknown_effect":
        return None
    return describe(begin(drives, known, reference)).sentence


def _of_verifying(checked: Verified | None, held_out: Sequence[Recording]) -> list[str]:
    """Return what the verification warns of."""
    if not held_out:
        return ["one recording: nothing could be held out, the figures are of held-out blocks"]
    return [
        f"worse than before beyond its bounds: {error.regime}"
        for error in (checked.worse if checked else ())
    ]


def options_of(
    steps: int, sensor_known_good: bool, add: Sequence[str], retrain_minutes: float
) -> Options:
    """Return the options; raises UsageError if they make no sense."""
    if steps < 1:
        raise UsageError("--steps is at least 1")
    if retrain_minutes < 0.0:
        raise UsageError("--retrain takes minutes, 0 or more")
    return Options(steps, sensor_known_good, tuple(add), retrain_minutes)
