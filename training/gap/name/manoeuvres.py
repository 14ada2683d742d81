"""Manoeuvres that one can drive, as signals from plain kinematics, to tell two models apart."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import MG_RPM_PER_KG_H, STOICHIOMETRIC
from training.greybox.fit.case import reading
from training.greybox.fit.drive import ChainDrive, make
from training.greybox.fit.joint import JointFit

PERIOD_S: Final = 0.1
MODULATION_S: Final = 1.8  # the lambda controller's forced oscillation
MODULATION_PHI: Final = 0.025
AMBIENT_KPA, WARM_DEGC, INTAKE_DEGC = 99.0, 88.0, 32.0
FULL_CHARGE_MG: Final = 480.0  # at ambient pressure


@dataclass(frozen=True, slots=True)
class ProposedDrive:
    """The manoeuvre in which two models differ most."""

    name: str
    rms_phi: float  # of the difference
    difference: Mapping[str, float]  # every manoeuvre's

    def __str__(self) -> str:
        return f"{self.name} (the candidates differ by {self.rms_phi:.4f} RMS in phi)"


def separate(one: JointFit, other: JointFit) -> ProposedDrive:
    """Return the manoeuvre in which two fitted models differ most beyond their bases."""
    differs = {name: _rms(drive, one, other) for name, drive in library().items()}
    best = max(differs, key=lambda name: differs[name])
    return ProposedDrive(best, differs[best], differs)


def _rms(drive: ChainDrive, one: JointFit, other: JointFit) -> float:
    a = reading(drive, one.base, one.terms, one.parameters)
    b = reading(drive, other.base, other.terms, other.parameters)
    return float(np.sqrt(np.mean((a - b)[drive.scored] ** 2)))


def library() -> Mapping[str, ChainDrive]:
    """Return every manoeuvre as a drive of a warm or cold engine."""
    return {
        "steady sweep of load at 1,500 rpm": _drive(*_sweep_load(1500.0)),
        "steady sweep of load at 3,000 rpm": _drive(*_sweep_load(3000.0)),
        "speed sweep at constant load, 900 to 4,000 rpm": _drive(*_sweep_speed()),
        "tip-in and tip-out every five seconds at 2,000 rpm": _drive(*_tips()),
        "coasting with fuel cut and picking up again": _drive(*_coasting()),
        "motorway at 2,600 rpm": _drive(*_motorway()),
        "cold start with tip-ins": _drive(*_tips(), coolant=_warming()),
    }


def _time() -> FloatArray:
    return np.asarray(np.arange(2400) * PERIOD_S, dtype=np.float64)


def _sweep_load(rpm: float) -> tuple[FloatArray, FloatArray]:
    t = _time()
    return np.full(len(t), rpm), 90.0 + 500.0 * np.floor(t / 20.0) / 11.0


def _sweep_speed() -> tuple[FloatArray, FloatArray]:
    t = _time()
    return 900.0 + 3100.0 * t / t[-1], np.full(len(t), 220.0)


def _tips() -> tuple[FloatArray, FloatArray]:
    t = _time()
    pedal = (np.sin(2.0 * np.pi * t / 10.0) > 0.0).astype(np.float64)
    return np.full(len(t), 2000.0), 130.0 + 350.0 * _smooth(pedal, 5)


def _coasting() -> tuple[FloatArray, FloatArray]:
    t = _time()
    coasting = (t % 20.0) > 15.0
    return 2300.0 - 90.0 * np.maximum(t % 20.0 - 15.0, 0.0), np.where(coasting, -1.0, 260.0)


def _motorway() -> tuple[FloatArray, FloatArray]:
    t = _time()
    return 2600.0 + 60.0 * np.sin(t / 15.0), 330.0 + 80.0 * np.sin(t / 7.0)


def _warming() -> FloatArray:
    return np.minimum(5.0 + 0.35 * _time(), WARM_DEGC)


def _smooth(x: FloatArray, steps: int) -> FloatArray:
    return np.asarray(
        np.convolve(
            np.pad(x, steps, mode="edge"), np.ones(2 * steps + 1) / (2 * steps + 1), "valid"
        )
    )


def _drive(rpm: FloatArray, charge_mg: FloatArray, coolant: FloatArray | None = None) -> ChainDrive:
    """Return the drive of engine speed and charge (n,); a charge below 0 is fuel cut."""
    t = _time()
    cut = charge_mg < 0.0
    air = np.where(cut, 80.0, charge_mg)
    phi = 1.0 + MODULATION_PHI * np.sign(np.sin(2.0 * np.pi * t / MODULATION_S))
    flow = air * rpm / MG_RPM_PER_KG_H
    pressure_kpa = np.minimum(15.0 + (AMBIENT_KPA - 15.0) * air / FULL_CHARGE_MG, 2.0 * AMBIENT_KPA)
    purging = (np.sin(2.0 * np.pi * t / 60.0) > 0.0) & (pressure_kpa < 0.85 * AMBIENT_KPA) & ~cut
    signals = {
        "engine_speed_rpm": rpm,
        "air_mass_mg": air,
        "fuel_mass_mg": np.where(cut, 0.0, air / STOICHIOMETRIC * phi),
        "maf_kg_h": flow,
        "rail_pressure_mpa": 5.0 + 9.0 * np.minimum(air / 700.0, 1.0) + rpm / 900.0,
        "manifold_pressure_kpa": pressure_kpa,
        "manifold_temperature_degc": np.full(len(t), INTAKE_DEGC),
        "coolant_temperature_degc": np.full(len(t), WARM_DEGC) if coolant is None else coolant,
        "ambient_pressure_kpa": np.full(len(t), AMBIENT_KPA),
        "purge_duty_percent": np.where(purging, 50.0, 0.0),
    }
    return make("manoeuvre", PERIOD_S, signals, np.ones(len(t)))
