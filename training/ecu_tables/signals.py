"""Inputs of the tables' fit from a recording: fuel command, air, mixture, operating point.

Fuel is the pulse width where the recording has one, else the fuel mass. Air is the mass per
stroke as broadcast, else speed density from the manifold pressure, else the air meter behind the
filling of the manifold.
"""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Final

import numpy as np
from scipy.constants import zero_Celsius
from scipy.ndimage import morphological_gradient
from scipy.signal import savgol_filter

from monitor.base.errors import RecordingError, UsageError
from monitor.base.runs import since
from monitor.base.types import BoolArray, FloatArray, IntArray
from monitor.grid.column_times import interval
from training.ecu_tables.config import defaults
from training.greybox.chain import CYLINDERS, KG_H_PER_MG_RPM, SPEED_LEAST_RPM
from training.greybox.quantity.dynamics import delayed
from training.recordings.ecu_table import KPA, MG_PER_STROKE, RAIL_REFERENCE_MPA
from training.recordings.recording import Recording
from training.recordings.samples.rows import hold

R_AIR: Final = 287.0  # J/(kg K)
LITRES: Final = 2.0  # displacement where nobody says one: the flow scale is then unknown
PULSE: Final = "injector_pulse_width_ms"
NEEDED: Final = (  # one of each
    ("engine_speed_rpm",),
    ("lambda_measured",),
    (PULSE, "fuel_mass_mg"),
    (MG_PER_STROKE, KPA, "maf_kg_h"),
)
WARM_DEGC: Final = 88.0
MANIFOLD_DEGC: Final = 35.0
VOLTS: Final = 14.0
PHI_LEAST: Final = 0.70  # below it the gas is that of fuel cut, or the sensor at its end
PHI_MOST: Final = 1.45
ACROSS_S: Final = 0.3  # half of the window over which the mixture's move is taken
AIR_S: Final = 0.35
SMOOTH_LEAST: Final = 5
VOLTS_S: Final = 0.6  # a logger's 0.1 V is coarse, and the voltage moves slowly
AIR_ACROSS_S: Final = 1.0
HOLD_MOST_S: Final = 1.0  # longest gap of a signal that holds its value


class Air(StrEnum):
    """Where the air per stroke comes from."""

    STROKE = "air mass per stroke"
    SPEED_DENSITY_VE = "manifold pressure and the ECU's volumetric efficiency"
    SPEED_DENSITY = "manifold pressure"
    METER = "air meter behind the manifold"


AIR_NEEDS: Final = {  # the best first
    Air.STROKE: (MG_PER_STROKE,),
    Air.SPEED_DENSITY_VE: (KPA, "volumetric_efficiency_percent"),
    Air.SPEED_DENSITY: (KPA,),
    Air.METER: ("maf_kg_h",),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class TableDrive:
    """One recording on its grid; every array has shape (n,)."""

    name: str
    period_s: float
    every: int  # samples between two updates of the reading
    cylinders: int
    rpm: FloatArray
    load: FloatArray  # in the unit of the load axis
    commanded: FloatArray  # pulse width in ms, else fuel in mg per stroke; 0 in fuel cut
    volts: FloatArray
    pressure: FloatArray  # square root of the fuel pressure over its reference
    air: FloatArray  # mg per stroke, smooth; the air meter's flow per speed before the manifold
    command: FloatArray  # smooth over raw air, which takes the air's noise out of the fuel too
    cold: FloatArray  # 0 warm, 1 at 28 °C
    phi: FloatArray  # measured, 1 / lambda
    usable: BoolArray
    rejected: Mapping[str, int]  # why → samples
    move: FloatArray  # range of phi within 0.3 s, which bounds what can be predicted
    air_move: FloatArray  # range of the air's logarithm in the last second, for the same reason

    def __len__(self) -> int:
        return len(self.rpm)

    def part(self, which: slice) -> "TableDrive":
        """Return some of the samples."""
        arrays = {f.name: getattr(self, f.name) for f in fields(self)}
        return replace(self, **{k: v[which] for k, v in arrays.items() if np.ndim(v)})


@dataclass(frozen=True, slots=True)
class TableSubject:
    """The drives of one vehicle and the kinds of their signals."""

    drives: tuple[TableDrive, ...]
    air: Air
    load: str  # name of the load axis
    known: frozenset[str]  # signals of all drives
    absolute_air: bool  # the air is in true milligrams, so flows can be told

    @property
    def samples(self) -> int:
        """Return the number of usable samples."""
        return int(sum(int(d.usable.sum()) for d in self.drives))

    @property
    def seconds(self) -> float:
        """Return for how long the usable samples stand."""
        return sum(float(d.usable.sum()) * d.every * d.period_s for d in self.drives)

    def logs(self) -> list["TableSubject"]:
        """Return each drive that may fill a cell alone, the two halves of a single one."""
        drives = self.drives
        if len(drives) == 1:
            usable = np.cumsum(drives[0].usable)
            middle = int(np.searchsorted(usable, usable[-1] / 2))
            drives = (drives[0].part(slice(0, middle)), drives[0].part(slice(middle, None)))
        alone = (replace(self, drives=(d,)) for d in drives)
        return [log for log in alone if log.seconds >= defaults().least_s]


def subject_of(
    recordings: Sequence[Recording],
    load: str | None = None,
    displacement_l: float | None = None,
    cylinders: int = CYLINDERS,
) -> TableSubject:
    """Return the drives of one vehicle.

    load : name of the load axis; None takes kPa, or mg per stroke without manifold pressure
    displacement_l : of all cylinders, in litres; without it speed density has no scale
    cylinders : turn the air meter's flow and the displacement into the charge of one
    Raises RecordingError if fuel, air, speed or lambda is missing, UsageError for a wrong size.
    """
    if displacement_l is not None and not 0.05 <= displacement_l <= 30.0:
        raise UsageError(f"displacement in litres {displacement_l:g}: 0.05 to 30 are wanted")
    if not 1 <= cylinders <= 16:
        raise UsageError(f"cylinders {cylinders}: 1 to 16 are wanted")
    known = frozenset.intersection(*(r.known for r in recordings))
    for needed in NEEDED:
        if known.isdisjoint(needed):
            raise RecordingError(f"{recordings[0].path}: tables need {' or '.join(needed)}")
    air = next(air for air, signals in AIR_NEEDS.items() if known.issuperset(signals))
    load = load or (KPA if KPA in known else MG_PER_STROKE)
    if load == KPA and KPA not in known:
        raise RecordingError(f"{recordings[0].path}: a load axis in kPa needs {KPA}")
    litres = displacement_l or LITRES
    drives = tuple(_drive(r, air, load, known, litres, cylinders) for r in recordings)
    absolute = air in (Air.STROKE, Air.METER) or displacement_l is not None
    if load == MG_PER_STROKE and not absolute:
        raise UsageError(f"{recordings[0].path}: a load axis in mg needs the displacement")
    subject, least_s = TableSubject(drives, air, load, known, absolute), defaults().least_s
    if subject.seconds < least_s:
        raise RecordingError(
            f"{recordings[0].path}: {subject.seconds:.1f} s of usable samples, at least "
            f"{least_s:g} s are wanted: {rejected_text(drives)}"
        )
    return subject


def rejected_text(drives: Sequence[TableDrive]) -> str:
    """Return how many samples were left out, the commonest reason first."""
    total = sum((Counter(drive.rejected) for drive in drives), Counter[str]())
    return ", ".join(f"{number} where {why}" for why, number in total.most_common())


def _drive(
    r: Recording, air: Air, load: str, common: Collection[str], litres: float, cylinders: int
) -> TableDrive:
    period_s = r.period_ns / 1e9
    most = max(round(HOLD_MOST_S / period_s), 1)
    columns = ((name, r.column(name)) for name in r.known)
    held = {n: np.where(since(np.isfinite(x), most) <= most, hold(x), np.nan) for n, x in columns}
    rpm = held["engine_speed_rpm"]
    charge = _charge(held, air, litres, cylinders)
    fuel = held[PULSE if PULSE in common else "fuel_mass_mg"]
    if "fuel_cut" in r.known:
        fuel = np.where(held["fuel_cut"] > 0.5, 0.0, fuel)
    with np.errstate(divide="ignore"):
        phi = 1.0 / r.column("lambda_measured")
    every = max(round(interval(phi)), 1)  # more for a slow sensor in a fast log
    load_values = held[KPA] if load == KPA else charge
    coolant = held.get("coolant_temperature_degc", np.full(len(rpm), WARM_DEGC))
    volts = held.get("battery_voltage_v", np.full(len(rpm), VOLTS))
    direct = {PULSE, "rail_pressure_mpa"} <= set(common)
    rail = held["rail_pressure_mpa"] if direct else np.full(len(rpm), RAIL_REFERENCE_MPA)
    of, which = _stays(phi)
    known = [rpm, charge, fuel, load_values, volts, coolant, rail]
    rejected = {
        "a signal has no value": ~np.isfinite([*known, phi]).all(axis=0),
        "the engine stands": ~(rpm > SPEED_LEAST_RPM),
        "the sensor is not ready": held.get("sensor_ready", np.ones(len(rpm))) <= 0.5,
        "lambda stands still for 2 s": of >= max(round(2.0 / period_s), 2),
        "lambda is repeated until its next update": which % every > 0,
        "lambda is that of fuel cut or of the sensor's end": (phi <= PHI_LEAST) | (phi >= PHI_MOST),
    }
    usable = ~np.any(list(rejected.values()), axis=0)
    first = np.argmax([*rejected.values(), usable], axis=0)
    rpm, charge, fuel, load_values, volts, coolant, rail = map(hold, known)
    half = round(AIR_ACROSS_S / 2.0 / period_s)
    raw = np.maximum(charge, 10.0)
    smooth = raw if air is Air.METER else np.maximum(_smooth(raw, AIR_S / period_s), 10.0)
    return TableDrive(
        name=r.path.name,
        period_s=period_s,
        every=every,
        cylinders=cylinders,
        rpm=np.maximum(rpm, SPEED_LEAST_RPM),
        load=load_values,
        commanded=fuel,
        volts=np.clip(_smooth(volts, VOLTS_S / period_s), 6.0, 18.0),
        pressure=np.sqrt(np.maximum(rail, 0.1) / RAIL_REFERENCE_MPA),
        air=smooth,
        command=np.ones(len(rpm)) if air is Air.METER else smooth / raw,
        cold=np.maximum(WARM_DEGC - coolant, 0.0) / 60.0,
        phi=hold(phi),
        usable=usable,
        rejected={why: int((first == k).sum()) for k, why in enumerate(rejected)},
        move=_range(hold(phi), round(ACROSS_S / period_s)),
        air_move=delayed(_range(np.log(raw), half), half),
    )


def _charge(held: Mapping[str, FloatArray], air: Air, litres: float, cylinders: int) -> FloatArray:
    """Return the air per stroke in mg; of an air meter before the manifold."""
    if air is Air.STROKE:
        return held["air_mass_mg"]
    if air is Air.METER:
        per_mg = KG_H_PER_MG_RPM * cylinders * np.maximum(held["engine_speed_rpm"], SPEED_LEAST_RPM)
        return np.asarray(held["maf_kg_h"] / per_mg)
    degc = held.get("manifold_temperature_degc", np.full(len(held[KPA]), MANIFOLD_DEGC))
    efficiency = np.full(len(degc), 0.85)
    if air is Air.SPEED_DENSITY_VE:
        efficiency = held["volumetric_efficiency_percent"] / 100.0
    volume_m3 = litres * 1e-3 / cylinders
    return np.asarray(efficiency * volume_m3 * held[KPA] * 1e9 / (R_AIR * (degc + zero_Celsius)))


def _stays(phi: FloatArray) -> tuple[IntArray, IntArray]:
    """Return for each sample of how many (n,) with its value it is, and which of them (n,)."""
    changed = np.append(True, phi[1:] != phi[:-1])
    stay = np.cumsum(changed)
    return np.bincount(stay)[stay], since(changed)


def _smooth(values: FloatArray, samples: float) -> FloatArray:
    """Return the values smoothed by a moving parabola (Savitzky and Golay, 1964)."""
    samples = 2 * int(samples / 2.0) + 1
    if samples < SMOOTH_LEAST or samples > len(values):
        return values
    return np.asarray(savgol_filter(values, samples, 2, mode="nearest"))


def _range(values: FloatArray, half: int) -> FloatArray:
    return np.asarray(morphological_gradient(values, (2 * half + 1,)))
