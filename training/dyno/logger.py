"""A tuner's logger: it asks the ECU for its values at a fixed rate and writes the answers."""

from collections.abc import Mapping
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.dyno.cycles import STEP_S
from training.dyno.engine import EngineLayout

RESOLUTION: Final[Mapping[str, float]] = {
    "engine_speed_rpm": 1.0,
    "lambda_measured": 0.001,
    "lambda_target": 0.001,
    "injector_pulse_width_ms": 0.001,
    "battery_voltage_v": 0.1,
    "coolant_temperature_degc": 1.0,
    "manifold_temperature_degc": 1.0,
    "throttle_percent": 0.5,
    "vehicle_speed_km_h": 1.0,
    "lambda_correction_percent": 0.1,
    "closed_loop": 1.0,
    "fuel_cut": 1.0,
    "manifold_pressure_kpa": 0.1,
    "volumetric_efficiency_percent": 0.1,
    "maf_kg_h": 0.1,
    "rail_pressure_mpa": 0.01,
}
OF_METERING: Final = {
    "speed_density": ("manifold_pressure_kpa", "volumetric_efficiency_percent"),
    "maf": ("maf_kg_h",),
}
ONLY_SOME: Final = {*OF_METERING["speed_density"], *OF_METERING["maf"], "rail_pressure_mpa"}


def columns(layout: EngineLayout) -> tuple[str, ...]:
    """Return the names that the logger of such a car writes."""
    common = tuple(name for name in RESOLUTION if name not in ONLY_SOME)
    rail = ("rail_pressure_mpa",) if layout.injection == "direct" else ()
    return (*common, *OF_METERING[layout.metering], *rail)


def polled(
    signals: Mapping[str, FloatArray], names: tuple[str, ...], period_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return times (n,) in s and values (n, n_names) as the ECU answers them."""
    n = len(signals[names[0]])
    t_s = np.arange(0.0, (n - 1) * STEP_S, period_s)
    at = np.floor(t_s / STEP_S + 1e-6).astype(np.int64)
    steps = np.array([RESOLUTION[each] for each in names])
    read = np.column_stack([signals[each][at] for each in names])
    return t_s, np.asarray(np.round(np.rint(read / steps) * steps, 6))
