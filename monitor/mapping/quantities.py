"""Each canonical signal as databases and loggers name it, and its values in an engine that runs."""

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from monitor.base.signals import BY_NAME
from monitor.frames.units import Unit, unit_of
from monitor.mapping.words import VOCABULARY

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


def _quantity(name: str, row: dict[str, Any]) -> MapQuantity:
    text = BY_NAME[name].unit if name in BY_NAME else ""
    unit = unit_of(_OWN_UNITS.get(text or name, text), STOICHIOMETRIC)
    assert unit is not None
    low, high = row["typical"]
    also = frozenset(row.get("also", "").split())
    return MapQuantity(row["phrases"], (low, high), also, unit, low == high)


QUANTITIES: Final = {name: _quantity(name, row) for name, row in VOCABULARY["quantities"].items()}
LAMBDA_FAMILY: Final = {"lambda_measured", "lambda_controller", "sensor_ready", "lambda_target"}
# must be upstream, of the first bank
OF_ONE_SENSOR: Final = LAMBDA_FAMILY - {"lambda_target"} | {"sensor_heater_percent"}
_VARYING: Final = (
    "lambda_measured lambda_controller maf_kg_h air_mass_mg fuel_mass_mg manifold_pressure_kpa "
    "engine_speed_rpm rail_pressure_mpa fuel_flow_kg_h injector_pulse_width_ms load_g_per_rev "
    "sensor_heater_percent"
)
VARYING: Final = frozenset(_VARYING.split())  # move while an engine runs
