"""Numbers of the healthy behaviour: ``default.toml`` as one frozen object, read once."""

from dataclasses import dataclass
from typing import Final

from monitor.base.files.settings import ShippedSettings, built


@dataclass(frozen=True, slots=True)
class HealthyConfig:
    """Operating points, the spread of healthy drives, and their controller."""

    warm_degc: float
    visited_min_s: float
    unvisited_max: float
    unvisited_reason_min: float
    column_size_min: float
    correction_penalties: tuple[float, ...]
    coolant_step_phi: float
    function_spread_phi: float
    signature_spread_phi: float
    gain_spread_phi: float
    span_spread: float
    sensor_phase_spread_s: float
    charge_phase_spread_s: float
    controller_ratio_min: float
    controller_ratio_max: float
    controller_fuel_min_mg: float


CONFIG: Final = built(HealthyConfig, ShippedSettings("training.healthy").values()["healthy"])
