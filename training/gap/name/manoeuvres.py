"""Manoeuvres that one can drive, as signals from plain kinematics, to tell candidates apart."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import MG_RPM_PER_KG_H, STOICHIOMETRIC
from training.greybox.effects import Effect
from training.greybox.fit.case import reading
from training.greybox.fit.drive import ChainDrive, make
from training.greybox.fit.joint import NEARBY, JointFit, JointSearch, fit
from training.healthy.base_state import BaseState

SECONDS: Final = 240.0  # of a manoeuvre
MODULATION_S: Final = 1.8  # the lambda controller's forced oscillation
MODULATION_PHI: Final = 0.025
AMBIENT_KPA, WARM_DEGC, INTAKE_DEGC = 99.0, 88.0, 32.0
FULL_CHARGE_MG: Final = 480.0  # at ambient pressure
ONE_LOOK: Final = JointSearch(NEARBY.scale, NEARBY.tolerance, 1)  # errors and slopes, no step


def propose(state: BaseState, candidates: Sequence[JointFit]) -> str | None:
    """Return the manoeuvre that parts candidates most; None of one or if they need other signals.

    That is the sum of squares, in sigma, that a rival leaves of what the leader reads, after its
    constants have followed as far as the present drives let them, where healthy drives have been.
    Source: Atkinson and Fedorov, The design of experiments for discriminating between two rival
    models, Biometrika 62 (1975).
    """
    if len(candidates) < 2:
        return None
    drives, known = courses(state.case.drives), state.known
    if known is not None:
        drives = {name: known.known_of(drive) for name, drive in drives.items()}
    first, *rivals = candidates
    pairs = [pair for rival in rivals for pair in ((first, rival), (rival, first))]
    needs = {n for c in candidates for t in c.terms if isinstance(t, Effect) for n in t.needs}
    if any(not needs <= set(drive.signals) for drive in drives.values()):
        return None
    return max(drives, key=lambda name: min(_evidence(state, drives[name], *p) for p in pairs))


def _evidence(state: BaseState, drive: ChainDrive, true: JointFit, rival: JointFit) -> float:
    """Return the sum of squares in sigma that the rival leaves per second of a drive.

    What healthy drives differ by counts as little as it does in a fit.
    """
    if not drive.kept.any():
        return 0.0
    read = reading(drive, true.base, true.terms, true.parameters)
    driven = replace(
        state.case,
        drives=(replace(drive, phi_measured=read),),
        corrections=(np.zeros(len(drive)),),
        shrinks=state.shrinks_of(drive),
        scales=(),
    )
    found = fit(driven, rival.terms, [rival], ONE_LOOK)
    e, slopes = found.residual, found.jacobian
    step = np.linalg.lstsq(rival.hessian + slopes.T @ slopes, slopes.T @ e)[0]
    return max(float(e @ e - (slopes.T @ e) @ step), 0.0) / (len(drive) * drive.period_s)


def courses(drives: Sequence[ChainDrive]) -> Mapping[str, ChainDrive]:
    """Return every manoeuvre, and the present drives to be driven again."""
    return {**library(drives[0].period_s), **{f"a drive like {d.name}": d for d in drives}}


def library(period_s: float) -> Mapping[str, ChainDrive]:
    """Return every manoeuvre as a drive of a warm or cold engine, of at least a minute."""
    t_s = np.arange(0.0, SECONDS, period_s)
    warm = np.full(len(t_s), WARM_DEGC)
    made = {name: (*of(t_s), warm) for name, of in MANOEUVRES.items()}
    made["cold start with tip-ins"] = (*_tips(t_s), np.minimum(5.0 + 0.35 * t_s, WARM_DEGC))
    return {name: _drive(t_s, *each) for name, each in made.items()}


def _sweep_load(t_s: FloatArray, rpm: float) -> tuple[FloatArray, FloatArray]:
    return np.full(len(t_s), rpm), 90.0 + 500.0 * np.floor(t_s / 20.0) / 11.0


def _sweep_speed(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    return 900.0 + 3100.0 * t_s / t_s[-1], np.full(len(t_s), 220.0)


def _tips(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    pressed = np.clip(0.5 + 2.5 * np.sin(2.0 * np.pi * t_s / 10.0), 0.0, 1.0)
    return np.full(len(t_s), 2000.0), 130.0 + 350.0 * pressed


def _coasting(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    coasting_s = np.maximum(t_s % 20.0 - 15.0, 0.0)
    return 2300.0 - 90.0 * coasting_s, np.where(coasting_s > 0.0, -1.0, 260.0)


def _motorway(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    return 2600.0 + 60.0 * np.sin(t_s / 15.0), 330.0 + 80.0 * np.sin(t_s / 7.0)


# Engine speed in 1/min and charge in mg per stroke, (n,), over time in s; below 0 is fuel cut.
MANOEUVRES: Final[Mapping[str, Callable[[FloatArray], tuple[FloatArray, FloatArray]]]] = {
    "steady sweep of load at 1,500 rpm": partial(_sweep_load, rpm=1500.0),
    "steady sweep of load at 3,000 rpm": partial(_sweep_load, rpm=3000.0),
    "speed sweep at constant load, 900 to 4,000 rpm": _sweep_speed,
    "tip-in and tip-out every five seconds at 2,000 rpm": _tips,
    "coasting with fuel cut and picking up again": _coasting,
    "motorway at 2,600 rpm": _motorway,
}


def _drive(
    t: FloatArray, rpm: FloatArray, charge_mg: FloatArray, coolant: FloatArray
) -> ChainDrive:
    """Return the drive of engine speed and charge (n,); a charge below 0 is fuel cut."""
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
        "coolant_temperature_degc": coolant,
        "ambient_pressure_kpa": np.full(len(t), AMBIENT_KPA),
        "purge_duty_percent": np.where(purging, 50.0, 0.0),
    }
    return make("manoeuvre", float(t[1]), signals, np.ones(len(t)))
