"""Operating points that healthy drives have visited: elsewhere nothing can be held against a model.

What the model misses at an operating point is learned from healthy drives. A new drive's samples
where none of them was would show that miss as a gap, so they do not count.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.types import BoolArray, FloatArray, IntArray
from training.greybox.fit.drive import ChainDrive
from training.healthy.config import CONFIG as LIMITS

SPEEDS_RPM: Final = np.array([1050.0, 1550.0, 2100.0, 2800.0, 3600.0, 4500.0])
LOADS_MG: Final = np.array([125.0, 210.0, 330.0, 500.0])
COOLANTS_DEGC: Final = np.array([15.0, 40.0, 65.0, 82.5])  # between the knots of `features`


@dataclass(frozen=True, slots=True)
class Visited:
    """Cells of speed and load, and ranges of coolant temperature, that were visited."""

    cells: BoolArray  # (n_speeds + 1, n_loads + 1)
    coolants: BoolArray  # (n_coolants + 1,)

    @classmethod
    def of(cls, drives: Sequence[ChainDrive]) -> "Visited":
        """Return the operating points that scored samples of the drives visited.

        If one of them does not say its coolant temperature, every temperature counts as visited.
        """
        seconds = np.zeros((len(SPEEDS_RPM) + 1, len(LOADS_MG) + 1))
        warm = np.zeros(len(COOLANTS_DEGC) + 1)
        for drive in drives:
            speed, load = (each[drive.scored] for each in _places(drive.signals))
            np.add.at(seconds, (speed, load), drive.period_s)
            coolant = _coolant(drive.signals)
            if coolant is None:
                warm[:] = np.inf
            else:
                np.add.at(warm, coolant[drive.scored], drive.period_s)
        return cls(seconds >= LIMITS.visited_min_s, warm >= LIMITS.visited_min_s)

    def on(self, drive: ChainDrive) -> BoolArray:
        """Return where a drive is within, (n,)."""
        return np.logical_and.reduce([*self.parts(drive).values()])

    def parts(self, drive: ChainDrive) -> dict[str, BoolArray]:
        """Return where a drive is within, (n,) each, in speed and load and in temperature."""
        coolant = _coolant(drive.signals)
        parts = {"speeds and loads": self.cells[_places(drive.signals)]}
        if coolant is not None:
            parts["coolant temperatures"] = self.coolants[coolant]
        return parts


def _places(signals: Mapping[str, FloatArray]) -> tuple[IntArray, IntArray]:
    rpm, mg = signals["engine_speed_rpm"], signals["air_mass_mg"]
    return np.searchsorted(SPEEDS_RPM, rpm), np.searchsorted(LOADS_MG, mg)


def _coolant(signals: Mapping[str, FloatArray]) -> IntArray | None:
    coolant = signals.get("coolant_temperature_degc")
    return None if coolant is None else np.searchsorted(COOLANTS_DEGC, coolant)
