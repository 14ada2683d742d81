"""Errors that the chain would show on a drive of the vehicle without some effects.

The healthy behaviour is learned where fuel and lambda controller make the mixture right. An effect
moves both: for the same mixture, the vehicle without it injects other fuel, and its controller
stands higher by as much.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import valve_phi
from training.greybox.effects.model_effect import Effects, along
from training.greybox.fit.drive import ChainDrive, path_of
from training.healthy.behaviour import Healthy
from training.healthy.config import CONFIG as LIMITS

RATIO: Final = (LIMITS.controller_ratio_min, LIMITS.controller_ratio_max)
MOVED: Final = ("fuel_mass_mg", "lambda_controller")


def corrections(
    known: Healthy, drives: Sequence[ChainDrive], effects: Effects
) -> tuple[FloatArray, ...]:
    """Return the chain's expected error, (n,) in phi, on each drive without the effects."""
    return tuple(
        known.correction(drive)
        - known.learned(known.columns(drive))
        + known.learned(known.columns(_without(known, drive, effects)))
        for drive in drives
    )


def _without(known: Healthy, drive: ChainDrive, effects: Effects) -> ChainDrive:
    """Return the drive with the same mixture of a vehicle without the effects."""
    path = path_of(drive, known.base)
    moved = along(path, effects, drive.signals, drive.period_s)
    injects = path.fuel_mg > LIMITS.controller_fuel_min_mg
    phi = np.where(injects, valve_phi(path), 1.0)
    ratio = np.where(injects, np.clip(valve_phi(moved) / phi, *RATIO), 1.0)
    broadcast = {name: drive.signals[name] * ratio for name in MOVED if name in drive.signals}
    return replace(drive, signals={**drive.signals, **broadcast})
