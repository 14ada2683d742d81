"""The named effects in a new model: whether they may be added, and the file that came of it."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from monitor.base.errors import ModelError
from training.gap.add import choice, constants
from training.gap.inputs.roles import GapOptions
from training.gap.inputs.subject import Subject
from training.gap.name.knowledge import Knowledge
from training.gap.name.verdict import Naming
from training.greybox.effects.model_effect import ModelEffect
from training.healthy import card
from training.jobs import Progress

NO_BETTER: Final = (
    "what was named is not added: with it the model predicts no better, it follows the effect "
    "already"
)
DIFFERS_BY_DRIVE: Final = (
    "what was named is not added: fitted to some of the recordings it predicts the others no "
    "better, so it is another in every drive"
)


@dataclass(frozen=True, slots=True)
class Addition:
    """A new model and its effects; without a path nothing was added, and warnings may say why."""

    path: Path | None = None
    form: str = ""  # a sentence
    effects: tuple[ModelEffect, ...] = ()
    warnings: tuple[str, ...] = ()
    withdrawn: str | None = None  # why the new model is an offer only
    offer: Path | None = None  # its file then, instead of ``path``

    def kept(self, path: Path) -> "Addition":
        """Return the addition with its file, if there is one, moved to ``path``."""
        return self if self.path is None else replace(self, path=self.path.replace(path))

    def offered(self, path: Path, why: str) -> "Addition":
        """Return the addition as an offer, its file moved to ``path``."""
        if self.path is None:
            return self
        return replace(self, path=None, offer=self.path.replace(path), withdrawn=why)


def add(
    subject: Subject,
    naming: Naming,
    knowledge: Knowledge,
    out: Path,
    options: GapOptions,
    progress: Progress,
) -> Addition:
    """Write the model with the named effects to ``out`` and return the addition."""
    if naming.verdict not in ("named", "unknown_effect") or not naming.answer.effects:
        return Addition()
    progress("adding")
    material, known = subject.material, knowledge.known
    choices = constants.constant_choices(subject, naming, known, knowledge.start)
    if not choices:
        return Addition(warnings=(DIFFERS_BY_DRIVE,))
    try:
        new, form, effects = choice.add(
            material=material,
            out=out,
            choices=choices,
            known=known,
            start=knowledge.start,
            options=options,
            progress=progress,
        )
    except ModelError as error:  # ParityError is one
        return Addition(warnings=(f"what was named is not added: {error}",))
    if new is None:
        return Addition(warnings=(NO_BETTER,))
    if known is not None and material.healthy and subject.is_greybox:
        card.store(new, known, material.healthy)  # with which its constants go
    return Addition(new, form, effects, withdrawn=withheld_effects(naming, options))


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
