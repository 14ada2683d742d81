"""The gap workflow from recordings to a new model: localise, name, add, verify.

The name is looked for in all recordings. The constants in the new model come from those that are
not held out, and what is said of the new model from those that are.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from monitor.base.errors import ModelError
from monitor.model.card import ModelCard
from training.gap import localisation, reference
from training.gap.add import choice, constants
from training.gap.healthy import card as reference_card
from training.gap.healthy import coverage
from training.gap.healthy.behaviour import Healthy
from training.gap.inputs import base, suitability
from training.gap.inputs.roles import Given, Options, split
from training.gap.name import vehicle_mix, yardstick
from training.gap.name.description import describe
from training.gap.name.naming import name
from training.gap.name.start import begin
from training.gap.name.verdict import Naming
from training.gap.result import ModelFile, Result, Step
from training.gap.verify.verification import verify
from training.gap.where.localise import Findings, localise
from training.greybox.chain import Constants
from training.greybox.effects.model_effect import Added, uncertain
from training.greybox.fit.comparison import Compared
from training.greybox.fit.drive import Drive
from training.greybox.graph.chain_graph import Greybox
from training.jobs.checkpoints import Checkpoints, Progress
from training.recordings.prediction import predicted_phi
from training.recordings.recording import training_recording

NEW_MODEL: Final = "model.onnx"
NO_USE: Final = (
    "what was named is not added: with it the model predicts no better, it follows the effect "
    "already"
)
VARIES: Final = (
    "what was named is not added: fitted to some of the recordings it predicts the others no "
    "better, so it is another in every drive"
)


def investigate(
    given: Given,
    out: Path,
    options: Options,
    *,
    known: Healthy | None = None,
    stages: Checkpoints | None = None,
    progress: Progress = lambda _: None,
) -> Result:
    """Return what was found; a new model, if there is one, is ``out``/model.onnx.

    known : what ``yardstick.learn`` made of the healthy recordings, if it is there already; without
        healthy recordings it is what the model's card says
    stages : where results of a run that was stopped are kept
    Raises RecordingError or ModelError if recordings or model cannot be used.
    """
    began_s, stages = time.monotonic(), stages or Checkpoints()
    card = base.check(given.model)
    missing = suitability.check_files(given.roles, card, given.model.name)
    if missing:
        return localisation.investigate(
            given.model,
            card,
            (*given.recordings, *given.verify),
            given.healthy,
            missing,
            sensor_known_good=options.sensor_known_good,
            progress=progress,
        )
    drives = _drives(given)
    on = _yardstick(given, card, known, stages, progress)
    found = stages.done("where", lambda: _localise(given, progress)) if options.localise else None
    naming = stages.done("name", lambda: _name(drives, card, on, options, progress))
    if on.known is None and naming.base is not None and card.kind != base.GREYBOX:
        on = replace(on, start=naming.base)  # nothing said what the vehicle's chain is
    mixing = vehicle_mix.warn(
        _with_own(drives, on.known),
        vehicle_mix.chain_of(naming, on.base),
        _with_own(base.plain_drives_of(card, given.healthy, given.healthy), on.known),
    )
    new, form, added, warnings = _add(given, out, options, naming, on, progress)
    fitted_to, held_out = split(given)
    checked = None
    if held_out:
        checked = stages.done(
            "verify",
            lambda: verify(
                given.model,
                new,
                held_out,
                given.healthy,
                chain=on.plain,
                accepted=[given.recordings[i] for i in fitted_to] if new else (),
                faults=options.faults,
                progress=progress,
            ),
        )
    doubts = [
        *suitability.unlearned(given.recordings, given.healthy),
        *coverage.unvisited(drives, on.known),
        *on.doubts,
        *suitability.poor(card),
    ]
    return Result(
        ModelFile.of(given.model),
        tuple(map(training_recording, given.recordings)),
        tuple(map(training_recording, given.healthy)),
        tuple(map(training_recording, held_out)),
        found,
        naming,
        added,
        form,
        checked,
        new,
        _steps(naming),
        _unknown(naming, drives, on),
        (*doubts, *mixing, *warnings, *uncertain(added), *suitability.held_out(card, held_out)),
        options.sensor_known_good,
        time.monotonic() - began_s,
    )


@dataclass(frozen=True, slots=True)
class Yardstick:
    """What the recordings are held against."""

    start: Constants  # of the chain, from the model's card
    known: Healthy | None
    doubts: Sequence[str] = ()

    @property
    def base(self) -> Constants:
        """Constants on which effects are named, beside the healthy vehicle's own volumes."""
        return self.known.base if self.known else self.start

    @property
    def plain(self) -> Constants:
        """Constants of the chain without volumes."""
        return self.known.plain if self.known else self.start


def _drives(given: Given) -> list[Drive]:
    drives = base.drives_of(given.model, given.recordings, given.healthy)
    suitability.check_long(drives, "new")
    suitability.check_moving(drives)
    return drives


def _yardstick(
    given: Given, card: ModelCard, known: Healthy | None, stages: Checkpoints, progress: Progress
) -> Yardstick:
    """Return what is given, else what healthy recordings teach, else what the card says."""
    start = base.constants_of(card)
    if known is not None:
        return Yardstick(start, known)
    if given.healthy:
        return Yardstick(start, stages.done("healthy", lambda: _learn(given, start, progress)))
    known, doubts = reference_card.known_of(card)
    return Yardstick(start, known, [*doubts, *suitability.fitted_to(card, given.recordings)])


def _name(
    drives: Sequence[Drive], card: ModelCard, on: Yardstick, options: Options, progress: Progress
) -> Naming:
    return name(
        drives,
        on.known,
        on.base if card.kind == base.GREYBOX else None,
        steps=options.steps,
        sensor_known_good=options.sensor_known_good,
        progress=progress,
    )


def _learn(given: Given, start: Constants, progress: Progress) -> Healthy:
    drives = base.drives_of(given.model, given.healthy, given.healthy)
    suitability.check_long(drives, "healthy")
    return yardstick.learn(drives, start, progress)


def _with_own(drives: Sequence[Drive], known: Healthy | None) -> list[Drive]:
    return [known.with_own(drive) if known else drive for drive in drives]


def _localise(given: Given, progress: Progress) -> Findings:
    progress("localising")
    card = base.check(given.model)
    chain = Greybox.of(card) if card.kind == base.GREYBOX else None
    new, known = (
        [
            Compared.of(drive, phi, chain.path(drive.signals) if chain else None)
            for drive, phi in zip(
                base.plain_drives_of(card, each), predicted_phi(given.model, each), strict=True
            )
        ]
        for each in (given.recordings, given.healthy)
    )
    return localise(new, known)


def _add(
    given: Given, out: Path, options: Options, naming: Naming, on: Yardstick, progress: Progress
) -> tuple[Path | None, str, tuple[Added, ...], list[str]]:
    """Return the new model, its form, what it has more, and what to say of that."""
    wanted, warnings = _to_add(naming, options)
    if not wanted:
        return None, "", (), warnings
    progress("adding")
    choices = constants.refitted(given, naming, on.known, on.start)
    if not choices:
        return None, "", (), [*warnings, VARIES]
    try:
        new, form, added = choice.add(
            given, out / NEW_MODEL, choices, on.known, on.start, options, progress
        )
    except ModelError as error:  # ParityError is one
        return None, "", (), [*warnings, f"what was named is not added: {error}"]
    if new is None:
        return None, "", (), [*warnings, NO_USE]
    if on.known is not None and given.healthy and base.check(given.model).kind == base.GREYBOX:
        reference.store(new, on.known, given.healthy)  # with which its constants go
    return new, form, added, warnings


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


def _steps(naming: Naming) -> tuple[Step, ...]:
    first = Step("", naming.rmse_before)
    return (first, *(Step(r.effect.name, r.rmse, r.ranking) for r in naming.rounds))


def _unknown(naming: Naming, drives: Sequence[Drive], on: Yardstick) -> str | None:
    if naming.verdict != "unknown_effect":
        return None
    return describe(begin(drives, on.known, on.base)).sentence
