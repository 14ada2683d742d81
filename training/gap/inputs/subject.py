"""The model under study and its recordings as the later steps want them."""

from dataclasses import dataclass

from monitor.model.card import ModelCard
from training.gap.inputs import suitability
from training.gap.inputs.roles import Material
from training.greybox.chain import Constants
from training.greybox.fit.drive import ChainDrive
from training.healthy import base
from training.recordings.recording import Recording


@dataclass(frozen=True, slots=True)
class Subject:
    """A model that predicts phi, and drives on which its chain can run."""

    material: Material
    card: ModelCard
    drives: list[ChainDrive]  # of the recordings with the gap, with the charge that the model sees

    @classmethod
    def of(cls, material: Material, card: ModelCard) -> "Subject":
        """Return the subject; raises RecordingError if the drives are too short or stand still."""
        drives = base.drives_of(material.model, material.recordings, material.healthy)
        suitability.check_long(drives, "new")
        suitability.check_moving(drives)
        return cls(material, card, drives)

    @property
    def is_greybox(self) -> bool:
        """Return whether the model is the chain itself, not a network."""
        return self.card.kind == base.GREYBOX

    @property
    def start(self) -> Constants:
        """Return the chain's constants from the model's card, usual ones for a network."""
        return base.constants_of(self.card)

    @property
    def own(self) -> list[Recording]:
        """Return the recordings that the effects in the model were fitted to: it knows them."""
        fitted = {
            each["sha256"] for effect in self.card.effects for each in effect.get("recordings", ())
        }
        return [each for each in self.material.recordings if each.sha256 in fitted]

    def healthy_drives(self) -> list[ChainDrive]:
        """Return drives, healthy or known to the model; raises RecordingError if too short."""
        healthy = self.material.healthy
        drives = base.drives_of(self.material.model, [*healthy, *self.own], healthy)
        suitability.check_long(drives, "healthy")
        return drives
