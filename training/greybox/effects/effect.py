"""What an effect is, and the few quantities that several effects use."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from monitor.base.types import BoolArray, FloatArray
from training.greybox.chain import MG_RPM_PER_KG_H, Path

Signals = Mapping[str, FloatArray]
Tag = Literal["physics", "fault-like", "either"]
Apply = Callable[[Path, FloatArray, Signals, float], Path]

FLOW_MIN_KG_H: Final = 3.0
STANDARD_KPA: Final = 101.3
KELVIN: Final = 273.15
GAS_KG_PER_M3: Final = 0.44  # exhaust at 800 K and ambient pressure


@dataclass(frozen=True, slots=True)
class Parameter:
    """One constant of an effect."""

    name: str
    unit: str
    low: float
    high: float
    start: tuple[float, ...]  # fits begin from each of these
    least: float = 0.0  # size below which it is not told from the bus's message phases
    positive: bool = False  # below 0 it is something else than this effect
    spread: float | None = None  # about its start, for drives that do not hold it; None is any


@dataclass(frozen=True, slots=True)
class Effect:
    """One entry of the library."""

    name: str
    says: str  # what the vehicle does, as a sentence's end
    parameters: tuple[Parameter, ...]
    apply: Apply  # path, parameters (k,), signals, period in s → path
    needs: tuple[str, ...]  # signals without which it cannot be fitted
    tag: Tag
    like: tuple[str, ...] = ()  # what it cannot be told from by construction
    gain_class: bool = False  # a constant factor on the mixture, seen against a reference only
    varies: bool = False  # from drive to drive, so that it may begin between two of them


Own = tuple[tuple[Effect, FloatArray], ...]  # effects of a healthy vehicle, with their constants


def along(path: Path, own: Own, signals: Signals, period_s: float) -> Path:
    """Return the path with effects on it, one after the other."""
    for effect, values in own:
        path = effect.apply(path, values, signals, period_s)
    return path


def injecting(signals: Signals) -> BoolArray:
    """Return where fuel is injected (n,): in a cut that of the walls may still enter."""
    return np.asarray(signals["fuel_mass_mg"] > 0.0)


def flow_kg_h(path: Path, signals: Signals) -> FloatArray:
    """Return the exhaust's mass flow (n,) from the charge and engine speed."""
    flow = path.air_mg * signals["engine_speed_rpm"] / MG_RPM_PER_KG_H
    return np.maximum(flow, FLOW_MIN_KG_H)


def ambient_kpa(signals: Signals) -> FloatArray | float:
    """Return ambient pressure, the standard one where it is not measured."""
    return signals.get("ambient_pressure_kpa", STANDARD_KPA)
