"""Drives beside a model's prediction, and the length of blocks for statistics over them."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.types import BoolArray, FloatArray
from training.greybox.fit.drive import ChainDrive

BLOCK_S = 30.0  # a block holds many cycles of the lambda controller and a manoeuvre or two
FOLDS = 5  # of blocks that are held out together


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """A drive beside a model's free run on it, in phi on the model's grid.

    Raises RecordingError if the lengths differ.
    """

    name: str
    period_s: float
    signals: Mapping[str, FloatArray]  # canonical name → (n,), NaN where the signal is bad
    phi_measured: FloatArray  # (n,)
    phi_predicted: FloatArray  # (n,)
    scored: BoolArray  # (n,) enabled, outside fuel cut and its recovery
    residual: FloatArray = field(init=False)  # (n,) measured minus predicted, 0 where not scored

    @classmethod
    def of(cls, drive: ChainDrive, phi_predicted: FloatArray) -> "Comparison":
        """Return a drive beside a model's prediction (n,) in phi."""
        return cls(
            name=drive.name,
            period_s=drive.period_s,
            signals=drive.signals,
            phi_measured=drive.phi_measured,
            phi_predicted=phi_predicted,
            scored=drive.scored,
        )

    def __post_init__(self) -> None:
        n = len(self.phi_measured)
        others = {"prediction": self.phi_predicted, "scored samples": self.scored, **self.signals}
        for what, values in others.items():
            if values.shape != (n,):
                raise RecordingError(
                    f"{self.name}: {what} has shape {values.shape}, wanted ({n},) as measured phi"
                )
        difference = self.phi_measured - self.phi_predicted
        scored = self.scored & np.isfinite(difference)
        object.__setattr__(self, "scored", scored)
        object.__setattr__(self, "residual", np.where(scored, difference, 0.0))
