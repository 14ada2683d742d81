"""Each canonical signal as databases and loggers name it, and its values in an engine that runs."""

from dataclasses import dataclass
from typing import Any, Final

from monitor.base.signals import BY_NAME
from monitor.frames.units import Unit, unit_of
from monitor.mapping.words import VOCABULARY

STOICHIOMETRIC: Final = 14.7  # kg of air per kg of gasoline, the number of most AFR gauges
FUEL_FLOW_NAME: Final = "fuel_flow_kg_h"  # not canonical: fuel per stroke follows from it
GASOLINE_KG_L: Final = 0.745
VARYING: Final = frozenset(VOCABULARY["words"]["varying"].split())  # while an engine runs


@dataclass(frozen=True, slots=True)
class MapQuantity:
    """One canonical signal as a database may describe it."""

    name: str
    unit: Unit  # the canonical one
    phrases: dict[str, float]  # see ``words.match``
    typical: tuple[float, float]  # a signal that cannot carry these values is another quantity
    also: frozenset[str]  # words that may stand beside those of a phrase
    one_sensor: bool = False  # must be upstream, of the first bank
    volume: str = ""  # quantity of units that the density converts

    @property
    def is_flag(self) -> bool:
        """Return whether it is 0 or 1."""
        return self.typical[0] == self.typical[1]


def _quantity(name: str, row: dict[str, Any]) -> MapQuantity:
    unit = unit_of(row.pop("unit", "") or BY_NAME[name].unit, STOICHIOMETRIC)
    assert unit is not None
    (low, high), also = row.pop("typical"), frozenset(row.pop("also", "").split())
    return MapQuantity(name, unit, typical=(low, high), also=also, **row)


QUANTITIES: Final = {
    name: _quantity(name, {**row}) for name, row in VOCABULARY["quantities"].items()
}
