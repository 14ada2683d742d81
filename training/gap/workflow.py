"""The gap workflow from recordings to a new model: localise, name, add, verify.

The name is looked for in all recordings. The constants in the new model come from those that are
not held out, and the errors of the new model are measured on those that are.
"""

import time
from pathlib import Path
from typing import Final

from training.gap import localisation
from training.gap.add.addition import Addition, add
from training.gap.healthy.behaviour import Healthy
from training.gap.inputs import base, suitability
from training.gap.inputs.roles import Material, Options
from training.gap.inputs.subject import Subject
from training.gap.name.knowledge import Knowledge
from training.gap.name.naming import name
from training.gap.name.verdict import Naming
from training.gap.result import ModelFile, Result, steps_of
from training.gap.verify.evidence import Verification
from training.gap.verify.verification import verify
from training.gap.where.findings import Findings, localise
from training.greybox.effects.model_effect import uncertain
from training.jobs.checkpoints import Checkpoints, Progress
from training.recordings.recording import training_recording

NEW_MODEL: Final = "model.onnx"
UNVERIFIED: Final = "unverified.onnx"  # until the monitor has run with it


def investigate(
    material: Material,
    out: Path,
    options: Options,
    *,
    known: Healthy | None = None,
    stages: Checkpoints | None = None,
    progress: Progress = lambda _: None,
) -> Result:
    """Return the result of all steps; a new model, if there is one, is ``out``/model.onnx.

    No model with which the monitor is worse off than with the old one is written.

    known : the healthy behaviour, if ``yardstick.learn`` has learned it before; else it is learned
        from the healthy recordings, or read from the model's card
    stages : folder in which a run that was stopped keeps its results
    Raises RecordingError or ModelError if recordings or model cannot be used.
    """
    began_s, stages = time.monotonic(), stages or Checkpoints()
    card = base.check(material.model)
    missing = suitability.check_files(material.roles, card, material.model.name)
    if missing:
        return localisation.investigate(
            model=material.model,
            card=card,
            recordings=(*material.recordings, *material.verify),
            healthy=material.healthy,
            missing=missing,
            sensor_known_good=options.sensor_known_good,
            progress=progress,
        )
    subject = Subject.of(material, card)
    before = Knowledge.of(subject, known, stages, progress)
    where = None
    if options.localise:
        where = stages.done("where", Findings, lambda: _where(subject, progress))
    naming = stages.done(
        "name",
        Naming,
        lambda: name(
            subject.drives,
            before.known,
            before.base if subject.is_greybox else None,
            steps=options.steps,
            sensor_known_good=options.sensor_known_good,
            progress=progress,
        ),
    )
    knowledge = before.after(naming, subject)
    mixing = knowledge.mix_warnings(subject, naming)
    addition = add(
        subject=subject,
        naming=naming,
        knowledge=knowledge,
        out=out / UNVERIFIED,
        options=options,
        progress=progress,
    )
    verification = None
    if material.held_out:
        verification = stages.done(
            "verify",
            Verification,
            lambda: _verification(material, addition, knowledge, options, progress),
        )
    addition, harm = delivered(addition, verification, out / NEW_MODEL)
    return Result(
        model=ModelFile.of(material.model),
        recordings=tuple(map(training_recording, material.recordings)),
        healthy=tuple(map(training_recording, material.healthy)),
        held_out=tuple(map(training_recording, material.held_out)),
        findings=where,
        naming=naming,
        added=addition.effects,
        form=addition.form,
        verified=verification,
        new_model=addition.path,
        withdrawn=harm,
        steps=steps_of(naming),
        unknown=knowledge.unknown_effect(subject.drives, naming),
        warnings=(
            *suitability.unlearned_effect_warnings(material.recordings, material.healthy),
            *knowledge.coverage_warnings(subject.drives),
            *knowledge.doubts,
            *suitability.poor_model_warnings(card),
            *mixing,
            *addition.warnings,
            *uncertain(addition.effects),
            *suitability.held_out_warnings(card, material.held_out),
        ),
        sensor_known_good=options.sensor_known_good,
        seconds=time.monotonic() - began_s,
    )


def delivered(
    addition: Addition, verification: Verification | None, path: Path
) -> tuple[Addition, str | None]:
    """Return what stays of an addition, its file as ``path``, and why the file was deleted."""
    harm = verification.harm if verification and addition.path else None
    return (addition.withdrawn() if harm else addition.kept(path)), harm


def _where(subject: Subject, progress: Progress) -> Findings:
    progress("localising")
    return localise(*subject.compared())


def _verification(
    material: Material,
    addition: Addition,
    knowledge: Knowledge,
    options: Options,
    progress: Progress,
) -> Verification:
    return verify(
        material.model,
        addition.path,
        material.held_out,
        material.healthy,
        chain=knowledge.plain,
        accepted=material.fit if addition.path else (),
        faults=options.faults,
        progress=progress,
    )
