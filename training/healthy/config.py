"""Numbers of the healthy behaviour: ``default.toml`` as one frozen object, read once."""

import tomllib
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Final


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


def _load() -> HealthyConfig:
    """Return the file as an object; raises TypeError if a key is too few or too many."""
    text = files("training.healthy").joinpath("default.toml").read_text(encoding="utf-8")
    values: Any = {
        k: tuple(v) if isinstance(v, list) else v for k, v in tomllib.loads(text).items()
    }
    return HealthyConfig(**values)


CONFIG: Final = _load()
