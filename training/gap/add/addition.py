"""The named effects in a new model: whether they may be added, and the files that come of it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from monitor.base import config
from monitor.base.errors import ModelError, RecordingError
from monitor.judge.limits import Limits
from monitor.model.step import Model
from training.gap.add import greybox, network
from training.gap.add.constants import constants_of, groups
from training.gap.inputs.roles import ACCEPTED, GapOptions
from training.gap.inputs.subject import Subject
from training.gap.name.knowledge import Knowledge
from training.gap.name.verdict import Naming
from training.greybox.effects.model_effect import Effects
from training.greybox.fit.drive import ChainDrive
from training.greybox.fit.joint import JointFit
from training.greybox.graph.chain_graph import Greybox
from training.greybox.graph.effect_inputs import Ranges
from training.healthy import card
from training.jobs import Progress
from training.limits.decision_limits import with_limits
from training.limits.judging import judge_recordings
from training.narx.export import update_card
from training.recordings.recording import Recording, training_recording

NO_BETTER: Final = (
    "what was found is not added: with constants from the other recordings the model predicts a "
    "recording no better; it follows the effect already, this is another in every drive, or "
    "one drive alone holds what a constant needs, such as a cold start"
)
IN_CHAIN: Final = "It stands inside the chain, where it acts on the mixture's way."
AT_OUTPUT: Final = "To the network's output comes the chain with it less the chain without it."


@dataclass(frozen=True, slots=True)
class Addition:
    """A new model and its effects; without a path nothing was added, and warnings may say why."""

    path: Path | None = None
    left_out: tuple[Path, ...] = ()  # per group of recordings, with constants from the others
    form: str = ""  # a sentence
    effects: Effects = ()
    warnings: tuple[str, ...] = ()
    withdrawn: str | None = None  # why the new model is an offer only
    offer: Path | None = None  # its file then, instead of ``path``


def add(
    subject: Subject,
    naming: Naming,
    knowledge: Knowledge,
    folder: Path,
    options: GapOptions,
    progress: Progress,
) -> Addition:
    """Write the model with the named effects into ``folder`` and return the addition.

    Beside it stands, unless others verify, a model for each group of recordings that its constants
    have not seen.
    """
    if naming.verdict not in ("named", "unknown_effect") or not naming.answer.effects:
        return Addition()
    progress("adding what was found")
    material, known = subject.material, knowledge.known
    found = constants_of(subject, naming, known, knowledge.start)
    if not found.ratio < 1.0:
        return Addition(warnings=(NO_BETTER,))
    write, each = _writer(subject, knowledge), list(material.recordings)
    new = folder / "new.onnx"
    try:
        write(new, found.whole, each)
    except ModelError as error:
        return Addition(warnings=(f"what was found is not added: {error}",))
    left_out = list[Path]()
    for group, fitted in enumerate(() if material.verify else found.left_out):
        others = [r for r, own in zip(each, groups(len(each)), strict=True) if own != group]
        if len(others) < len(each):
            left_out.append(folder / f"{group}.onnx")
            write(left_out[-1], fitted, others)
    if known is not None and material.healthy and subject.is_greybox:
        card.store(new, known, material.healthy)  # with which its constants go
    return Addition(
        path=new,
        left_out=tuple(left_out),
        form=IN_CHAIN if subject.is_greybox else AT_OUTPUT,
        effects=found.whole.effects,
        withdrawn=withheld_effects(naming, options),
    )


def withheld_effects(naming: Naming, options: GapOptions) -> str | None:
    """Return why a model is an offer: an effect may be a fault, or acts as it cannot by itself."""
    left = [c for c in naming.answer.effects if c.name not in options.add]
    if contrary := [c.name for c in left if c.is_reversed]:
        return (
            f"{' and '.join(contrary)} cannot act in this direction by itself; if the model is to "
            f"follow it all the same, say so with --add {' '.join(contrary)}"
        )
    names = [c.name for c in left if c.tag == "fault-like" and not options.sensor_known_good]
    if not names:
        return None
    return (
        f"{' and '.join(names)} may be a fault of the vehicle; where it is known to be none, say "
        f"so with --add {' '.join(names)}"
    )


def _writer(
    subject: Subject, knowledge: Knowledge
) -> Callable[[Path, JointFit, Sequence[Recording]], None]:
    """Return what writes the model with effects fitted to recordings, limits set on these."""
    model, known = subject.material.model, knowledge.known
    ranges = _ranges(subject.material.recordings, subject.drives)
    vehicle = Greybox.of(subject.card) if subject.is_greybox else None
    if known is not None and vehicle is not None:  # with the model's charge if the drives have it
        charged = any(drive.charged for drive in subject.drives)
        charge = vehicle.charge if charged else known.charge
        vehicle = replace(vehicle, own=known.own, charge=charge)

    def write(out: Path, found: JointFit, recordings: Sequence[Recording]) -> None:
        effects, of = found.effects, tuple(map(training_recording, recordings))
        if vehicle is not None:
            chain = replace(vehicle, constants=found.base)
            greybox.add(model, effects, out, ranges=ranges, recordings=of, vehicle=chain)
        else:
            network.add(model, effects, knowledge.plain, out, ranges=ranges, recordings=of)
        _set_limits(out, recordings)

    return write


def _ranges(recordings: Sequence[Recording], drives: Sequence[ChainDrive]) -> Ranges:
    """Return low and high of the signals that all recordings have."""
    return {
        name: (
            float(min(np.min(d.signals[name]) for d in drives)),
            float(max(np.max(d.signals[name]) for d in drives)),
        )
        for name in drives[0].signals
        if all(name in d.signals for d in drives)
        and all(name in recording.known for recording in recordings)  # not worked out
    }


def _set_limits(new: Path, recordings: Sequence[Recording]) -> None:
    """Set the limits of the new model on recordings, unless its old ones let it see more.

    A model without limits keeps none, and too few windows change nothing. The old limits stay
    where they give evidence more weight and no code stands on the recordings with them.
    """
    settings, model = config.load(), Model.load(new)
    if not model.card.limits:
        return
    try:
        set_anew = with_limits(model.card, [(model, recordings)], ACCEPTED, settings)
    except RecordingError:
        return
    found, old = (Limits.from_card(c, settings, str(new)) for c in (set_anew, model.card))
    if old.evidence <= found.evidence or any(
        each.dtcs for each in judge_recordings(recordings, model, old, settings)
    ):
        update_card(new, set_anew)
