"""Tables over axes, as an engine control unit holds them, with bounds and samples of each cell."""

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from monitor.base.counts import plain
from monitor.base.types import FloatArray, IntArray, Shown
from training.jobs.json_tree import json_tree

SCHEMA: Final = "o2train.tables/1"
DIGITS: Final = 6  # of numbers in files
MG_PER_STROKE, KPA = "air_mass_mg", "manifold_pressure_kpa"
LOAD_UNITS: Final[Mapping[str, str]] = {KPA: "kPa", MG_PER_STROKE: "mg/stroke"}
LOADS: Final[Mapping[str, tuple[float, ...]]] = {
    KPA: (20.0, 30.0, 40.0, 50.0, 65.0, 80.0, 100.0, 130.0, 170.0),
    MG_PER_STROKE: (80.0, 120.0, 170.0, 230.0, 300.0, 390.0, 500.0, 650.0, 850.0),
}
SPEEDS_RPM: Final = (800.0, 1100.0, 1500.0, 2000.0, 2500.0, 3000.0, 3700.0, 4500.0, 5500.0)
VOLTS: Final = (9.0, 10.0, 11.0, 12.0, 12.5, 13.0, 13.5, 14.0, 14.5, 15.0, 16.0)
RAIL_REFERENCE_MPA: Final = 10.0
FLOWS_KG_H: Final = (8.0, 12.0, 20.0, 30.0, 45.0, 70.0, 110.0, 170.0, 260.0)


@dataclass(frozen=True, slots=True)
class CoolantBand:
    """A band of coolant temperature; its tables hold at ``at_degc``."""

    low_degc: float
    high_degc: float
    at_degc: float


COOLANT_BANDS: Final = (
    CoolantBand(-40.0, 20.0, 10.0),
    CoolantBand(20.0, 40.0, 30.0),
    CoolantBand(40.0, 60.0, 50.0),
    CoolantBand(60.0, 80.0, 70.0),
    CoolantBand(80.0, 150.0, 88.0),
)


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis of a table."""

    name: str
    unit: str
    values: tuple[float, ...]  # rising

    def nearest(self, values: FloatArray) -> IntArray:
        """Return the place of the nearest axis value for each of the ``values`` (n,).

        >>> Axis("engine_speed_rpm", "1/min", (800.0, 1200.0)).nearest(np.array([0.0, 1001.0]))
        array([0, 1])
        """
        at = np.asarray(self.values)
        return np.asarray(np.searchsorted((at[1:] + at[:-1]) / 2.0, values), dtype=np.int64)


@dataclass(frozen=True, slots=True)
class TableAxes:
    """The axes of all tables of one vehicle."""

    speed: Axis
    load: Axis
    volts: Axis = Axis("battery_voltage_v", "V", VOLTS)
    exhaust_flow: Axis = Axis("exhaust_flow_kg_h", "kg/h", FLOWS_KG_H)

    def pressure(self, *, direct: bool) -> Axis:
        """Return the axis of the flow scale: one fuel pressure, at which the scale holds."""
        if direct:
            return Axis("rail_pressure_mpa", "MPa", (RAIL_REFERENCE_MPA,))
        return Axis("fuel_pressure_relative", "-", (1.0,))


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class EcuTable(Shown):
    """Estimate, 90 % bounds and samples of each cell; NaN where nothing was measured.

    ``log`` and ``at_s`` are log and begin of the longest stay in a cell, "" and NaN without one.
    """

    name: str
    unit: str
    axes: tuple[Axis, ...]
    estimate: FloatArray  # one dimension per axis
    low: FloatArray
    high: FloatArray
    samples: IntArray
    seconds: FloatArray = field(default_factory=lambda: np.empty(0))  # of driving, by samples
    coolant: CoolantBand | None = None
    blank: Mapping[str, int] = field(default_factory=dict)  # why → cells
    log: NDArray[np.str_] = field(default_factory=lambda: np.empty(0, np.str_))
    at_s: FloatArray = field(default_factory=lambda: np.empty(0))
    widened: float = 1.0  # factor by which the logs' disagreement widens the intervals, median

    @property
    def facts(self) -> dict[str, object]:
        """Return name, axes, filled cells and their range."""
        good = self.estimate[np.isfinite(self.estimate)]
        axes = " × ".join(axis.name for axis in self.axes)
        cells = f"{good.size} of {self.estimate.size}"
        told: dict[str, object] = {"table": self.key, "axes": axes, "cells": cells}
        if good.size:
            told["range"] = f"{plain(good.min(), 3)} to {plain(good.max(), 3)} {self.unit}"
        return told

    @property
    def key(self) -> str:
        """Return the name with the band of the coolant, as files are named."""
        band = self.coolant
        return self.name if band is None else f"{self.name}_{band.at_degc:.0f}degc"

    def reasons(self) -> str:
        """Return why cells are blank, with their numbers, the commonest first."""
        blank = sorted(self.blank.items(), key=lambda item: -item[1])
        return ", ".join(f"{why}: {cells}" for why, cells in blank if cells)

    def document(self) -> dict[str, Any]:
        """Return the table as JSON holds it, null where nothing was measured."""
        band = self.coolant and dict(zip(("low", "high", "at"), astuple(self.coolant), strict=True))
        return {
            "name": self.name,
            "unit": self.unit,
            **({"coolant_degc": band} if band else {}),
            "axes": [{"name": a.name, "unit": a.unit, "values": list(a.values)} for a in self.axes],
            "estimate": json_tree(self.estimate, DIGITS),
            "low": json_tree(self.low, DIGITS),
            "high": json_tree(self.high, DIGITS),
            "samples": self.samples.tolist(),
            "log": self.log.tolist(),
            "at_s": json_tree(self.at_s, DIGITS),
            "blank": {why: cells for why, cells in self.blank.items() if cells},
            "widened": round(self.widened, 3),
        }


def axes_of(load: str, speeds: Sequence[float] = (), loads: Sequence[float] = ()) -> TableAxes:
    """Return the axes over speed and load, the default values where none are given."""
    return TableAxes(
        Axis("engine_speed_rpm", "1/min", tuple(speeds) or SPEEDS_RPM),
        Axis(load, LOAD_UNITS[load], tuple(loads) or LOADS[load]),
    )
