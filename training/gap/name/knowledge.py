"""The healthy vehicle before anything is named: behaviour and chain that recordings are held to.

First choice is a ``Healthy`` that the caller brings, then the healthy recordings, then the healthy
reference in the model's card, last the card's constants alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from training.gap.inputs.subject import Subject
from training.gap.name.verdict import Naming
from training.greybox.chain import Constants
from training.healthy import card as reference_card
from training.healthy import yardstick
from training.healthy.behaviour import Healthy
from training.jobs import Progress

FEW_HEALTHY: Final = (
    f"fewer than {yardstick.GROUPS_LEAST} healthy recordings: how healthy drives differ is not "
    "known, and an effect or fault that is named may be such a difference"
)


@dataclass(frozen=True, slots=True)
class Knowledge:
    """Healthy behaviour of the vehicle, if there is any, and the constants of its chain."""

    start: Constants  # of the chain, from the model's card
    known: Healthy | None
    doubts: Sequence[str] = ()

    @classmethod
    def of(cls, subject: Subject, known: Healthy | None, progress: Progress) -> "Knowledge":
        """Return the knowledge from the best source that there is."""
        start = subject.start
        if known is not None:
            return cls(start, known)
        if subject.material.healthy or subject.own:
            learned = yardstick.learn(subject.healthy_drives(), start, progress)
            return cls(start, learned, [] if learned.surplus else [FEW_HEALTHY])
        return cls(start, *reference_card.known_of(subject.card))

    @property
    def plain(self) -> Constants:
        """Return the constants of the chain without volumes."""
        return self.known.plain if self.known else self.start

    def after(self, naming: Naming, subject: Subject) -> "Knowledge":
        """Return the knowledge with the naming's base, where nothing else said the constants."""
        if self.known is None and naming.base is not None and not subject.is_greybox:
            return replace(self, start=naming.base.constants)
        return self
