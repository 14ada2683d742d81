"""Each canonical signal as databases and loggers name it, and its values in an engine that runs."""

from collections.abc import Mapping
from typing import Final, NamedTuple

from monitor.base.signals import BY_NAME
from monitor.frames.units import Unit, unit_of

STOICHIOMETRIC: Final = 14.7  # kg of air per kg of gasoline, the number of most AFR gauges
FUEL_FLOW_NAME: Final = "fuel_flow_kg_h"  # not canonical: fuel per stroke follows from it
GASOLINE_KG_L: Final = 0.745
_OWN_UNITS: Final = {"mg/stroke": "mg", FUEL_FLOW_NAME: "kg/h"}


class MapQuantity(NamedTuple):
    """One canonical signal as a database may describe it."""

    phrases: Mapping[str, float]  # see ``words.match``
    typical: tuple[float, float]  # a signal that cannot carry these values is another quantity
    also: frozenset[str]  # words that may stand beside those of a phrase
    unit: Unit  # the canonical one
    is_flag: bool


_ROWS: Final = {  # phrases and how sure they are | values | words that may stand beside them
    "lambda_measured": "lambda 0.9, lambda sensor 0.97, air fuel ratio 0.95, "
    "equivalence ratio 0.95, equivalence 0.75, equivalence sensor 0.9 "
    "| 0.85 1.15 | pre valid wide range ratio oxygen o2 o2s",
    "lambda_target": "lambda target 1.0, lambda_target 1.0, air fuel ratio target 0.95, "
    "equivalence target 0.95 | 0.85 1.05 |",
    "lambda_controller": "lambda control 1.0, fuel trim short 1.0, fuel trim 0.9, trim short 0.9, "
    "fr 0.75, fuel control 0.75, trim 0.6, sensor control 0.7 | 0.92 1.08 | pre term",
    "fuel_mass_mg": "fuel mass 1.0, injection mass 1.0, fuel cylinder 0.9, fuel injection 0.7 "
    "| 3 40 | inj injector",
    "air_mass_mg": "air mass 1.0, cylinder mass 0.85, air cylinder 0.95, air 0.6 "
    "| 80 500 | int inlet intake air",
    "maf_kg_h": "maf 1.0, maf air flow 1.0, air mass flow 1.0, air mass 0.9, air flow 0.9, "
    "mass flow 0.6 | 8 150 | int inlet intake air",
    "rail_pressure_mpa": "rail pressure 1.0, fuel pressure high 1.0, fuel pressure 0.75, rail 0.8, "
    "pressure high 0.75 | 4 15 | fuel inj injector",
    "manifold_pressure_kpa": "map 0.95, manifold pressure 1.0 | 30 95 | int intk inlet air luft",
    "manifold_temperature_degc": "manifold temperature 1.0, iat 0.95, air temperature 0.8 "
    "| 0 50 | int intk inlet air luft",
    "coolant_temperature_degc": "coolant temperature 1.0, ect 0.95, coolant 0.75, "
    "engine temperature 0.8 | 20 85 |",  # the thermostat is open
    "ambient_temperature_degc": "ambient temperature 1.0, aat 0.9 | 0 30 | air luft",
    "ambient_pressure_kpa": "ambient pressure 1.0, baro pressure 1.0, baro 0.95 | 80 104 | air",
    "engine_speed_rpm": "engine speed 1.0, engine rpm 1.0, rpm 0.9, revolutions 0.8, engine n 0.8 "
    "| 800 5001 |",
    "vehicle_speed_km_h": "vehicle speed 1.0, vehicle v 0.75, geschwindigkeit 0.9, speed 0.65 "
    "| 10 120 | brk abs esp dsc",  # the ECU that measures it
    "engine_torque_nm": "engine torque 1.0, torque 0.7 | 10 120 |",
    "throttle_percent": "throttle position 1.0, throttle 0.95 | 3 80 |",
    "battery_voltage_v": "battery voltage 1.0, battery 0.7 | 11.5 14.5 | ulo lo lv",
    "purge_duty_percent": "purge duty 1.0, purge 0.8 | 2 80 | cmd command",
    "sensor_heater_percent": "lambda sensor heater duty 1.0, sensor heater 1.0, "
    "lambda heater duty 0.9 | 10 90 |",
    "closed_loop": "closed loop 1.0, lambda control active 0.95, b_lr 0.9 "
    "| 1 1 | mode status state on",
    "fuel_cut": "fuel cut 1.0, dfco 0.9 | 1 1 | status state on",
    "sensor_ready": "lambda sensor ready 1.0, lambda ready 0.95, oxygen sensor ready 0.95, "
    "b_sbb 0.9 | 1 1 | pre status state on",
    FUEL_FLOW_NAME: "fuel flow 1.0, fuel consumption 0.9, injection flow 0.8, consumption 0.7 "
    "| 0.3 15 |",
}


def _quantity(name: str, row: str) -> MapQuantity:
    phrases, typical, also = row.split("|")
    low, high = map(float, typical.split())
    text = BY_NAME[name].unit if name in BY_NAME else ""
    unit = unit_of(_OWN_UNITS.get(text or name, text), STOICHIOMETRIC)
    assert unit is not None
    pairs = (each.strip().rsplit(" ", 1) for each in phrases.split(","))
    weights = {concepts: float(weight) for concepts, weight in pairs}
    return MapQuantity(weights, (low, high), frozenset(also.split()), unit, low == high)


QUANTITIES: Final = {name: _quantity(name, row) for name, row in _ROWS.items()}
LAMBDA_FAMILY: Final = {"lambda_measured", "lambda_controller", "sensor_ready", "lambda_target"}
# must be upstream, of the first bank
OF_ONE_SENSOR: Final = LAMBDA_FAMILY - {"lambda_target"} | {"sensor_heater_percent"}
_VARYING: Final = (
    "lambda_measured lambda_controller maf_kg_h air_mass_mg fuel_mass_mg manifold_pressure_kpa "
    "engine_speed_rpm rail_pressure_mpa fuel_flow_kg_h injector_pulse_width_ms load_g_per_rev "
    "sensor_heater_percent"
)
VARYING: Final = frozenset(_VARYING.split())  # move while an engine runs
