"""Many plain functions of a drive, with which a ridge explains whatever can be explained at all.

They stand where the mixture is made (and travel the chain's way), at the sensor, and in time. The
same functions serve two ends: what the base model misses on healthy drives, and the ceiling against
which an effect is adequate.
"""

from typing import Final

import numpy as np
from numpy import gradient as slope

from monitor.base.types import FloatArray
from training.greybox.chain import Path
from training.greybox.effects.effect import Place
from training.greybox.fit.drive import ChainDrive
from training.greybox.quantity.dynamics import delayed, lag
from training.greybox.quantity.value import hats
from training.healthy.config import CONFIG

SPEED_KNOTS_RPM: Final = np.array([800.0, 1300.0, 1800.0, 2400.0, 3200.0])
LOAD_KNOTS_MG: Final = np.array([90.0, 160.0, 260.0, 400.0, 600.0])
COOLANT_KNOTS_DEGC: Final = np.array([0.0, 30.0, 55.0, 75.0, 90.0])


def features(drive: ChainDrive, path: Path, phi: FloatArray) -> dict[str, FloatArray]:
    """Return the drive's functions, name → (n,).

    path, phi : the base's path and what it reads (n,)
    """
    made = _at_valve(drive, path)
    lag_s, dead = path.mixing_s + path.sensor_rising_s, path.dead_time_s / drive.period_s
    late = {name: delayed(np.ascontiguousarray(x), dead) for name, x in made.items()}
    columns = {name: lag(x, lag_s, drive.period_s) for name, x in late.items()}
    return columns | _at_sensor(drive, path, phi)


def _at_valve(drive: ChainDrive, path: Path) -> dict[str, FloatArray]:
    s, period_s = drive.signals, drive.period_s
    air, fuel, rpm = path.air_mg, path.fuel_mg, s["engine_speed_rpm"]
    at = Place(path, s, period_s)
    running = at.injecting().astype(np.float64)
    speeds, loads = hats(rpm, SPEED_KNOTS_RPM), hats(air, LOAD_KNOTS_MG)
    made = {
        f"map {i}{j}": speeds[:, i] * loads[:, j] * running
        for i in range(len(SPEED_KNOTS_RPM))
        for j in range(len(LOAD_KNOTS_MG))
    }
    made["1/air"] = 100.0 / np.maximum(air, 50.0) * running
    made["charge slope"] = np.clip(slope(air, period_s) / np.maximum(air, 40.0), -3.0, 3.0)
    made["charge slope at low speed"] = made["charge slope"] * 1500.0 / np.maximum(rpm, 700.0)
    made["fuel slope"] = np.clip(slope(fuel, period_s) / np.maximum(fuel, 4.0), -3.0, 3.0) * running
    coolant = s.get("coolant_temperature_degc")
    degc = np.full(len(air), CONFIG.warm_degc) if coolant is None else coolant
    cold = np.maximum(CONFIG.warm_degc - degc, 0.0) / 60.0
    strokes = np.maximum(rpm, 500.0)
    for time_s in (0.3, 0.8, 2.0):
        late = lag(fuel * strokes, time_s, period_s) / strokes
        made[f"fuel film {time_s}"] = np.clip(late / np.maximum(fuel, 4.0) - 1.0, -1.5, 3.0)
        made[f"cold film {time_s}"] = cold * made[f"fuel film {time_s}"]
    for i, hat in enumerate(hats(coolant, COOLANT_KNOTS_DEGC).T if coolant is not None else ()):
        made[f"coolant {i}"] = hat
    made |= _context(drive, at, running)
    return made


def _context(drive: ChainDrive, at: Place, running: FloatArray) -> dict[str, FloatArray]:
    s, air, flow = drive.signals, at.path.air_mg, at.flow_kg_h()
    made: dict[str, FloatArray] = {}
    if "rail_pressure_mpa" in s:
        rail = np.log(np.maximum(s["rail_pressure_mpa"], 1.0) / 10.0)
        made |= {"rail": rail, "rail squared": rail**2}
    if "manifold_temperature_degc" in s:
        warm = (s["manifold_temperature_degc"] - 30.0) / 20.0
        made |= {"intake": warm, "intake at low flow": warm / (1.0 + flow / 30.0)}
    if "manifold_pressure_kpa" in s:
        boost = np.maximum(s["manifold_pressure_kpa"] / 98.0 - 0.9, 0.0)
        made["boost at low speed"] = boost * np.clip((2600.0 - s["engine_speed_rpm"]) / 800.0, 0, 1)
        if "purge_duty_percent" in s:
            drop = np.maximum(98.0 - s["manifold_pressure_kpa"], 0.0) / 98.0
            open_ = lag(0.01 * s["purge_duty_percent"] * drop, 1.0, drive.period_s)
            made |= {"purge": open_ * running, "purge by flow": open_ * 20.0 / flow * running}
    made["trim"] = s.get("lambda_controller", np.ones(len(air))) - 1.0
    return made


def _at_sensor(drive: ChainDrive, path: Path, phi: FloatArray) -> dict[str, FloatArray]:
    at = Place(path, drive.signals, drive.period_s)
    flow = at.flow_kg_h()
    above, rate = np.clip(phi - 1.0, -0.3, 0.3), np.clip(slope(phi, drive.period_s), -1.0, 1.0)
    curve = np.clip(slope(rate, drive.period_s), -5.0, 5.0)
    columns = {
        "constant": np.ones(len(phi)),
        "above": above,
        "above by flow": above * flow / 60.0,
        "above at low flow": above * 15.0 / flow,
        "lean": np.minimum(above, 0.0),
        "rate": rate,
        "rate at low flow": rate * 15.0 / flow,
        "rate by flow": rate * flow / 60.0,
        "rising": np.maximum(rate, 0.0),
        "curve": curve,
        "curve at low flow": curve * 15.0 / flow,
        "leak 20": np.exp(-flow / 20.0),
        "leak 50": np.exp(-flow / 50.0),
    }
    cut = ~at.injecting()
    for time_s in (0.5, 1.2, 3.0):
        columns[f"after cut {time_s}"] = lag(cut * 1.0, np.where(cut, 1.0, time_s), drive.period_s)
    return columns
