"""The canonical signals: name, unit, plausible range and role."""

from dataclasses import dataclass
from math import inf
from typing import Literal

Role = Literal["input", "output", "candidate", "context", "enable", "foreign"]


@dataclass(frozen=True, slots=True)
class Signal:
    """One canonical signal."""

    name: str
    unit: str
    minimum: float  # plausible range, in ``unit``
    maximum: float
    role: Role


SIGNALS: tuple[Signal, ...] = (
    Signal("air_mass_mg", "mg/stroke", 0.0, 2000.0, "input"),
    Signal("fuel_mass_mg", "mg/stroke", 0.0, 250.0, "input"),
    Signal("maf_kg_h", "kg/h", 0.0, 1200.0, "input"),
    Signal("rail_pressure_mpa", "MPa", 0.0, 40.0, "input"),
    Signal("manifold_pressure_kpa", "kPa", 5.0, 350.0, "input"),
    Signal("manifold_temperature_degc", "degC", -40.0, 150.0, "input"),
    Signal("lambda_controller", "-", 0.5, 1.5, "input"),
    Signal("lambda_measured", "-", 0.5, 16.0, "output"),
    Signal("vehicle_speed_km_h", "km/h", 0.0, 300.0, "candidate"),
    Signal("engine_speed_rpm", "1/min", 0.0, 9000.0, "candidate"),
    Signal("engine_torque_nm", "Nm", -200.0, 1000.0, "candidate"),
    Signal("throttle_percent", "%", 0.0, 100.0, "candidate"),
    Signal("lambda_target", "-", 0.5, 16.0, "context"),
    Signal("coolant_temperature_degc", "degC", -40.0, 150.0, "context"),
    Signal("ambient_temperature_degc", "degC", -50.0, 80.0, "context"),
    Signal("ambient_pressure_kpa", "kPa", 40.0, 115.0, "context"),
    Signal("battery_voltage_v", "V", 5.0, 18.0, "context"),
    Signal("purge_duty_percent", "%", 0.0, 100.0, "context"),
    Signal("sensor_heater_percent", "%", 0.0, 100.0, "context"),
    Signal("closed_loop", "-", 0.0, 1.0, "enable"),
    Signal("fuel_cut", "-", 0.0, 1.0, "enable"),
    Signal("sensor_ready", "-", 0.0, 1.0, "enable"),
    # what other ECUs and loggers have; the project's own ECU sends only those of the catalyst
    Signal("injector_pulse_width_ms", "ms", 0.0, 100.0, "foreign"),
    Signal("volumetric_efficiency_percent", "%", 0.0, 300.0, "foreign"),
    Signal("lambda_correction_percent", "%", -60.0, 100.0, "foreign"),
    Signal("load_g_per_rev", "g/rev", 0.0, 10.0, "foreign"),
    Signal("pump_current_ma", "mA", -20.0, 20.0, "foreign"),
    Signal("upstream_voltage_v", "V", -0.2, 5.0, "foreign"),
    Signal("downstream_voltage_v", "V", -0.2, 5.0, "foreign"),
    Signal("downstream_lambda", "-", 0.5, 16.0, "foreign"),
    Signal("catalyst_temperature_degc", "degC", -40.0, 1300.0, "foreign"),
    Signal("downstream_heater_percent", "%", 0.0, 100.0, "foreign"),
)

BY_NAME: dict[str, Signal] = {signal.name: signal for signal in SIGNALS}
OWN: tuple[Signal, ...] = tuple(s for s in SIGNALS if s.role != "foreign")
NARX_INPUTS: tuple[str, ...] = tuple(s.name for s in SIGNALS if s.role == "input")
OUTPUT = "lambda_measured"
CAPACITY = "catalyst_capacity_g"  # no signal but an estimate, in freeze frames


def unit_of(name: str) -> str:
    """Return the unit of a signal or an estimate, "" if it is unknown."""
    if name == CAPACITY:
        return "g"
    return BY_NAME[name].unit if name in BY_NAME else ""


def plausible_range(name: str) -> tuple[float, float]:
    """Return the plausible range of a signal, widened by rounding errors.

    A name that is not canonical has the range from -inf to +inf.

    >>> plausible_range("own_signal")
    (-inf, inf)
    """
    signal = BY_NAME.get(name)
    if signal is None:
        return -inf, inf
    margin = 1e-9 * (signal.maximum - signal.minimum)
    return signal.minimum - margin, signal.maximum + margin
