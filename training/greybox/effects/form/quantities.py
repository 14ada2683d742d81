"""Physical quantities that several effects use, as arrays; ``Place`` has them as nodes."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from monitor.base.types import BoolArray, FloatArray
from training.greybox.chain import MG_RPM_PER_KG_H, Path

Signals = Mapping[str, FloatArray]

FLOW_MIN_KG_H: Final = 3.0
SPEED_MIN_RPM: Final = 400.0  # of injection; below it the engine stands
STANDARD_KPA: Final = 101.3
KELVIN: Final = 273.15
GAS_KG_PER_M3: Final = 0.44  # exhaust at 800 K and ambient pressure
KG_PER_H_AND_LITRE_PER_S: Final = 3.6 * GAS_KG_PER_M3
AIR_FACTOR_MIN: Final = 0.5
AIR_FACTOR_MAX: Final = 2.0


def injecting(signals: Signals) -> BoolArray:
    """Return (n,) bool: fuel is injected. In a fuel cut, fuel from the walls may still enter."""
    return np.asarray(signals["fuel_mass_mg"] > 0.0)


def strokes_per_s(signals: Signals) -> FloatArray:
    """Return the intake strokes (n,) of all four cylinders per second."""
    return np.asarray(np.maximum(signals["engine_speed_rpm"], SPEED_MIN_RPM) / 30.0)


def ambient_kpa(signals: Signals, without: float = STANDARD_KPA) -> FloatArray | float:
    """Return the ambient pressure (n,), or ``without`` if it is not measured."""
    return signals.get("ambient_pressure_kpa", without)


def flow_kg_h(path: Path, signals: Signals) -> FloatArray:
    """Return the exhaust's mass flow (n,) from charge and engine speed."""
    flow = path.air_mg * signals["engine_speed_rpm"] / MG_RPM_PER_KG_H
    return np.maximum(flow, FLOW_MIN_KG_H)


def passage_s(path: Path, litres: float, signals: Signals) -> FloatArray:
    """Return the time (n,) in s in which the exhaust passes through a volume."""
    litres_per_s = flow_kg_h(path, signals) / 3600.0 / GAS_KG_PER_M3 * 1e3
    return np.asarray(litres / litres_per_s)


def longest_passage_s(litres: float) -> float:
    """Return the time in s in which the least flow passes through a volume, 0 for none."""
    return max(litres, 0.0) * KG_PER_H_AND_LITRE_PER_S / FLOW_MIN_KG_H


def air_times(path: Path, factor: FloatArray) -> Path:
    """Return the path with the cylinder's air times a factor (n,), limited to 0.5 .. 2."""
    return replace(path, air_mg=path.air_mg * np.clip(factor, AIR_FACTOR_MIN, AIR_FACTOR_MAX))
