"""The drive that would fill blank cells: which speeds, loads, temperatures and voltages, how long.

Only loads between visited ones of the same speed are asked for: a car that never came to 20 kPa at
7,000 rpm may not be able to.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from training.recordings.ecu_table import EcuTable

WANTED_S: Final = 40.0  # usable seconds that fill most cells
MOST: Final = 12


@dataclass(frozen=True, slots=True)
class Leg:
    """One part of the drive."""

    place: str
    seconds: float
    fills: str


def plan(tables: Sequence[EcuTable], period_s: float) -> list[Leg]:
    """Return the legs of the drive, the longest gaps first."""
    legs = []
    for table in tables:
        if table.name == "lambda_delay":
            legs += _operating_points(table, period_s)
    return sorted(legs, key=lambda leg: -leg.seconds)[:MOST] + _elsewhere(tables, period_s)


def _operating_points(table: EcuTable, period_s: float) -> list[Leg]:
    """Return one leg per speed with the loads that lack samples."""
    speed, load = table.axes
    seconds = table.samples * period_s
    visited = table.samples > 0
    below, above = (np.maximum.accumulate(v, axis=1) for v in (visited, visited[:, ::-1]))
    lacking = below & above[:, ::-1] & np.isnan(table.estimate)
    legs = []
    for i, rpm in enumerate(speed.values):
        at = np.flatnonzero(lacking[i])
        if len(at) == 0:
            continue
        loads = ", ".join(f"{load.values[j]:g}" for j in at)
        missing = float(np.maximum(WANTED_S - seconds[i, at], 5.0).sum())
        legs.append(Leg(f"{rpm:g} rpm at {loads} {load.unit}", missing, f"{len(at)} cells"))
    return legs


def _elsewhere(tables: Sequence[EcuTable], period_s: float) -> list[Leg]:
    """Return legs for cold coolant and other battery voltages."""
    legs = []
    for table in tables:
        band = table.coolant
        if band is not None and table.name == "wall_film_fraction" and not table.samples.any():
            place = f"a drive with coolant at {band.low_degc:g} to {band.high_degc:g} °C"
            legs.append(Leg(place, WANTED_S * 4, f"wall film at {band.at_degc:g} °C"))
        if table.name == "injector_dead_time":
            blank = np.isnan(table.estimate) & (table.samples > 0)
            volts = ", ".join(f"{v:g}" for v in np.asarray(table.axes[0].values)[blank])
            if volts:
                place = f"idle with loads switched on and off until the voltage is {volts} V"
                seconds = float(blank.sum()) * WANTED_S
                legs.append(Leg(place, seconds, "injector dead time"))
    return legs
