"""Paths of the signals in the Vehicle Signal Specification (COVESA VSS 5, branch Vehicle.OBD).

Values that the specification lacks stand under the branch ``Vehicle.O2Monitor``, as an overlay
would add them.
"""

from typing import Final

OBD: Final = "Vehicle.OBD"
OWN: Final = "Vehicle.O2Monitor"

SIGNALS: Final[dict[str, tuple[str, float]]] = {  # canonical name: path, factor to its unit
    "lambda_measured": (f"{OBD}.O2WR.Sensor1.Lambda", 1.0),
    "pump_current_ma": (f"{OBD}.O2WR.Sensor1.Current", 1e-3),  # A
    "downstream_voltage_v": (f"{OBD}.O2.Sensor2.Voltage", 1.0),
    "downstream_lambda": (f"{OBD}.O2WR.Sensor2.Lambda", 1.0),
    "engine_speed_rpm": (f"{OBD}.EngineSpeed", 1.0),
    "vehicle_speed_km_h": (f"{OBD}.Speed", 1.0),
    "maf_kg_h": (f"{OBD}.MAF", 1.0 / 3.6),  # g/s
    "manifold_pressure_kpa": (f"{OBD}.MAP", 1.0),
    "manifold_temperature_degc": (f"{OBD}.IntakeTemp", 1.0),
    "rail_pressure_mpa": (f"{OBD}.FuelRailPressureAbsolute", 1e3),  # kPa
    "throttle_percent": (f"{OBD}.ThrottlePosition", 1.0),
    "lambda_target": (f"{OBD}.CommandedEquivalenceRatio", 1.0),  # as PID 44: lambda
    "coolant_temperature_degc": (f"{OBD}.CoolantTemperature", 1.0),
    "ambient_temperature_degc": (f"{OBD}.AmbientAirTemperature", 1.0),
    "ambient_pressure_kpa": (f"{OBD}.BarometricPressure", 1.0),
    "battery_voltage_v": (f"{OBD}.ControlModuleVoltage", 1.0),
    "purge_duty_percent": (f"{OBD}.CommandedEVAP", 1.0),
    "catalyst_temperature_degc": (f"{OBD}.Catalyst.Bank1.Temperature1", 1.0),
}

MEASURED: Final = f"{OWN}.Measured"  # of an output that is not lambda
PREDICTED: Final = f"{OWN}.Predicted"
RESIDUAL: Final = f"{OWN}.Residual"
ENABLED: Final = f"{OWN}.IsEnabled"
WAITS_FOR: Final = f"{OWN}.WaitsFor"  # first enable condition that does not hold, "" for none
WINDOWS: Final = f"{OWN}.WindowsJudged"
MIL: Final = f"{OBD}.Status.IsMILOn"
DTC_COUNT: Final = f"{OBD}.Status.DTCCount"
