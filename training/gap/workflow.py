"""The gap workflow from recordings to a new model: name, add, verify.

Name and constants come from all recordings. The errors of the new model are measured on recordings
that verify, else on each recording by constants from the others.
"""

import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from monitor.base.files.outputs import check
from training.gap import run_comparison
from training.gap.add.addition import NO_BETTER, Addition, add
from training.gap.add.constants import groups
from training.gap.inputs import suitability
from training.gap.inputs.roles import GapOptions, Material
from training.gap.inputs.subject import Subject
from training.gap.name.knowledge import Knowledge
from training.gap.name.naming import name
from training.gap.name.verdict import Naming
from training.gap.response.drivers import name_of
from training.gap.result import Inputs, Result
from training.gap.verify.evidence import Verification
from training.gap.verify.verification import Fold, verify
from training.greybox.effects.model_effect import uncertain
from training.healthy import base
from training.healthy.behaviour import Healthy
from training.healthy.coverage import coverage_warnings
from training.jobs import Progress

NEW_MODEL: Final = "model.onnx"
OFFER: Final = "offer.onnx"
ONE_RECORDING: Final = (
    "one recording: nothing could be held out, the figures are of held-out blocks"
)


def investigate(
    material: Material,
    out: Path,
    options: GapOptions,
    *,
    known: Healthy | None = None,
    progress: Progress = lambda _: None,
) -> Result:
    """Return the result of all steps; a new model, if there is one, is ``out``/model.onnx.

    A model with which the monitor is worse off than with the old one, or whose effect may be a
    fault, is ``out``/offer.onnx instead. What an earlier run left under either name goes.

    known : the healthy behaviour, if ``yardstick.learn`` has learned it before; else it is learned
        from the healthy recordings, or read from the model's card
    Raises RecordingError, ModelError or UsageError if recordings, model or ``out`` cannot be used.
    """
    began_s = time.monotonic()
    out.mkdir(parents=True, exist_ok=True)
    check((out / NEW_MODEL, out / OFFER), (material.model,))
    card = base.card_of(material.model)
    missing = suitability.check_files(material.roles, card)
    if missing or card.transform != "phi":
        result = run_comparison.investigate(
            material, card, missing, sensor_known_good=options.sensor_known_good, progress=progress
        )
        delivered(result.addition, None, out)
        return result
    subject = Subject.of(material, card)
    found = Knowledge.of(subject, known, progress)
    naming = name(
        subject.drives,
        found.known,
        found.start if subject.is_greybox else None,
        steps=options.steps,
        sensor_known_good=options.sensor_known_good,
        progress=progress,
    )
    knowledge = found.after(naming, subject)
    with TemporaryDirectory(dir=out) as folder:
        addition = add(subject, naming, knowledge, Path(folder), options, progress)
        verification = _verification(subject, addition, knowledge, options, progress)
        whole = verification.overall if verification else None
        if whole and whole.after is not None and whole.after >= whole.before:
            addition = Addition(warnings=(NO_BETTER,))
            verification = _verification(subject, addition, knowledge, options, progress)
        addition = delivered(addition, verification, out)
    return Result(
        inputs=Inputs.of(
            material.model, card.kind, material.roles.values(), options.sensor_known_good
        ),
        naming=naming,
        addition=addition,
        verified=verification,
        unknown=_described(naming, verification),
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
    """Return how the new model does on recordings that its constants have not seen, if any."""
    material, new = subject.material, addition.path
    folds = [Fold(None, material.recordings)]
    if material.verify:
        folds = [Fold(new, material.verify)]
    elif new is not None:
        of = list(zip(material.recordings, groups(len(material.recordings)), strict=True))
        folds = [
            Fold(path, [r for r, own in of if own == group])
            for group, path in enumerate(addition.left_out)
        ]
    if not folds:
        return None
    return verify(
        material.model,
        folds,
        material.healthy,
        chain=knowledge.plain,
        new=new,
        faults=options.faults,
        progress=progress,
    )


def _described(naming: Naming, verification: Verification | None) -> str | None:
    """Return on what the error of an effect without name and formula depends most."""
    curve = verification.curve if verification else None
    if naming.verdict != "unknown_effect" or naming.answer.effects or curve is None:
        return None
    return f"Measured minus predicted phi depends most on the {name_of(curve.driver)}."


def delivered(addition: Addition, verification: Verification | None, out: Path) -> Addition:
    """Return the addition with its file in ``out``, as an offer if anything speaks against it."""
    why = addition.withdrawn or (verification.harm if verification else None)
    file = addition.path and addition.path.replace(out / (OFFER if why else NEW_MODEL))
    for other in {NEW_MODEL, OFFER} - {file and file.name}:  # of an earlier run
        (out / other).unlink(missing_ok=True)
    path, offer = (None, file) if why else (file, None)
    return replace(addition, path=path, offer=offer, withdrawn=why if file else None)


def _warnings(
    subject: Subject, knowledge: Knowledge, naming: Naming, addition: Addition
) -> tuple[str, ...]:
    """Return the warnings of all steps beside those of the naming."""
    material, card = subject.material, subject.card
    return (
        *suitability.unlearned_effect_warnings(material.recordings, material.healthy),
        *coverage_warnings(subject.drives, knowledge.known),
        *knowledge.doubts,
        *suitability.poor_model_warnings(card),
        *addition.warnings,
        *uncertain(addition.effects),
        *suitability.seen_in_fit_warnings(card, material),
        *([ONE_RECORDING] if len(material.recordings) == 1 and not material.verify else []),
    )
