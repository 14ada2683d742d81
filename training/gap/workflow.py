"""The gap workflow from recordings to a new model: name, add, verify.

The name is looked for in all recordings. The constants in the new model come from those that are
not held out, and the errors of the new model are measured on those that are.
"""

import time
from pathlib import Path
from typing import Final

from training.gap import run_comparison
from training.gap.add.addition import Addition, add
from training.gap.inputs import suitability
from training.gap.inputs.roles import GapOptions, Material
from training.gap.inputs.subject import Subject
from training.gap.name.knowledge import Knowledge
from training.gap.name.naming import name
from training.gap.name.verdict import Naming
from training.gap.result import Inputs, NewModelFile, Result
from training.gap.verify.evidence import Verification
from training.gap.verify.verification import verify
from training.greybox.effects.model_effect import uncertain
from training.healthy import base
from training.healthy.behaviour import Healthy
from training.jobs import Progress
from training.recordings.recording import training_recording

NEW_MODEL: Final = "model.onnx"
OFFER: Final = "offer.onnx"
UNVERIFIED: Final = "unverified.onnx"  # until the monitor has run with it


def investigate(
    material: Material,
    out: Path,
    options: GapOptions,
    *,
    known: Healthy | None = None,
    learned: Path | None = None,
    progress: Progress = lambda _: None,
) -> Result:
    """Return the result of all steps; a new model, if there is one, is ``out``/model.onnx.

    A model with which the monitor is worse off than with the old one, or whose effect may be a
    fault, is ``out``/offer.onnx instead.

    known : the healthy behaviour, if ``yardstick.learn`` has learned it before; else it is learned
        from the healthy recordings, or read from the model's card
    learned : file that keeps the healthy behaviour for later runs
    Raises RecordingError or ModelError if recordings or model cannot be used.
    """
    began_s = time.monotonic()
    card = base.card_of(material.model)
    missing = suitability.check_files(material.roles, card, material.model.name)
    if missing or card.transform != "phi":
        return run_comparison.investigate(
            model=material.model,
            card=card,
            recordings=(*material.recordings, *material.verify),
            healthy=material.healthy,
            missing=missing,
            sensor_known_good=options.sensor_known_good,
            progress=progress,
        )
    subject = Subject.of(material, card)
    found = Knowledge.of(subject, known, learned, progress)
    naming = name(
        subject.drives,
        found.known,
        found.base if subject.is_greybox else None,
        steps=options.steps,
        sensor_known_good=options.sensor_known_good,
        progress=progress,
    )
    knowledge = found.after(naming, subject)
    addition = add(
        subject=subject,
        naming=naming,
        knowledge=knowledge,
        out=out / UNVERIFIED,
        options=options,
        progress=progress,
    )
    verification = _verification(subject, addition, knowledge, options, progress)
    addition = delivered(addition, verification, out)
    return Result(
        inputs=_inputs(subject, options),
        naming=naming,
        addition=addition,
        verified=verification,
        unknown=knowledge.unknown_effect(subject.drives, naming),
        warnings=_warnings(subject, knowledge, naming, addition),
        seconds=time.monotonic() - began_s,
    )


def _verification(
    subject: Subject,
    addition: Addition,
    knowledge: Knowledge,
    options: GapOptions,
    progress: Progress,
) -> Verification | None:
    """Return how the new model does on held-out recordings; None if nothing is held out."""
    material = subject.material
    if not material.held_out:
        return None
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


def delivered(addition: Addition, verification: Verification | None, out: Path) -> Addition:
    """Return the addition with its file in ``out``, as an offer if anything speaks against it."""
    (out / OFFER).unlink(missing_ok=True)  # of an earlier run
    why = addition.withdrawn or (verification.harm if verification and addition.path else None)
    return addition.offered(out / OFFER, why) if why else addition.kept(out / NEW_MODEL)


def _inputs(subject: Subject, options: GapOptions) -> Inputs:
    """Return the model and the recordings as the report names them."""
    material = subject.material
    recordings, healthy, held_out = (
        tuple(map(training_recording, each))
        for each in (material.recordings, material.healthy, material.held_out)
    )
    return Inputs(
        model=NewModelFile.of(material.model, subject.card),
        recordings=recordings,
        healthy=healthy,
        held_out=held_out,
        sensor_known_good=options.sensor_known_good,
    )


def _warnings(
    subject: Subject, knowledge: Knowledge, naming: Naming, addition: Addition
) -> tuple[str, ...]:
    """Return the warnings of all steps beside those of the naming."""
    material, card = subject.material, subject.card
    return (
        *suitability.unlearned_effect_warnings(material.recordings, material.healthy),
        *knowledge.coverage_warnings(subject.drives),
        *knowledge.doubts,
        *suitability.poor_model_warnings(card),
        *knowledge.mix_warnings(subject, naming),
        *addition.warnings,
        *uncertain(addition.effects),
        *suitability.held_out_warnings(card, material.held_out),
    )
