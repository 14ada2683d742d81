"""Units of loggers and the way from one to another: base = factor * value + offset."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of a quantity, relative to the quantity's base unit."""

    quantity: str
    factor: float = 1.0
    offset: float = 0.0


# the names of each unit by quantity and factor; the base unit has the factor 1
_NAMES: Final[dict[str, dict[float, str]]] = {
    "pressure": {1.0: "kpa", 1e-3: "pa", 0.1: "mbar hpa", 100.0: "bar", 1000.0: "mpa"}
    | {6.894757: "psi psia psig", 3.386389: "inhg", 0.1333224: "mmhg", 101.325: "atm"}
    | {98.0665: "kg/cm2 kg/cm²"},
    "speed": {1.0: "km/h kph kmh", 1.609344: "mph", 3.6: "m/s"},
    "flow": {1.0: "kg/h kg/hr", 3.6: "g/s g/sec gram/s grams/sec grams/s gm/s", 3600.0: "kg/s"}
    | {27.215542: "lb/min lbs/min"},
    "time": {1.0: "s sec secs seconds", 1e-3: "ms msec millisec milliseconds", 60.0: "min"}
    | {3600.0: "h", 1e-6: "us µs μs", 1e-9: "ns"},
    "speed of rotation": {1.0: "1/min /min u/min rpm rev/min r/min min-1", 60.0: "hz"},
    "share": {1.0: "% percent pct"},
    "voltage": {1.0: "v volt volts", 1e-3: "mv"},
    "current": {1.0: "ma", 1000.0: "a", 1e-3: "µa"},
    "mass": {
        1.0: "mg mg/stroke mg/stk mg/str mg/cyl mg/hub",
        1000.0: "g g/stroke g/stk g/cyl g/hub",
    },
    "load": {1.0: "g/rev", 1e-3: "mg/rev"},
    "torque": {1.0: "nm n·m", 1.355818: "lbft lb-ft ft-lb"},
    "temperature": {1.0: "c °c degc celsius"},
    "lambda": {1.0: "lambda λ -"},
}
UNITS: Final[dict[str, Unit]] = {
    name: Unit(quantity, factor)
    for quantity, units in _NAMES.items()
    for factor, names in units.items()
    for name in names.split()
}
UNITS.update(
    dict.fromkeys(("f", "°f", "degf", "fahrenheit"), Unit("temperature", 1 / 1.8, -32 / 1.8))
)
UNITS.update(dict.fromkeys(("k", "kelvin"), Unit("temperature", 1.0, -273.15)))
AFR: Final = (
    "afr",
    "afrgasoline",
    ":1",
    "a/f",
    "air/fuel",
    "o2",
)  # lambda = value / stoichiometric


# stoichiometric ratio of the fuel that a unit names
FUELS: Final = {
    "e85": 9.8,
    "ethanol": 9.0,
    "methanol": 6.5,
    "diesel": 14.5,
    "lpg": 15.5,
    "cng": 17.2,
}


def unit_of(text: str, stoich_afr: float) -> Unit | None:
    """Return the unit that a logger calls ``text``, None if it is none that is known.

    >>> unit_of("PSI", 14.7).quantity, unit_of("AFR", 14.7).quantity, unit_of("bits", 14.7)
    ('pressure', 'lambda', None)
    """
    name = text.strip().casefold().replace(" ", "").rstrip(".")
    if name in AFR:
        return Unit("lambda", 1.0 / stoich_afr)
    fuel = name.removeprefix("afr").strip("()[]-_:")
    if name.startswith("afr") and fuel in FUELS:
        return Unit("lambda", 1.0 / FUELS[fuel])
    if len(name) > 1 and name[-1] in "cf" and not name[:-1].isalnum() and not name[:-1].isascii():
        name = f"°{name[-1]}"  # a degree sign that an encoding has spoilt
    if name.startswith("deg") and name[-1:] in ("c", "f"):
        name = f"°{name[-1]}"
    return UNITS.get(name)


def conversion(source: Unit, target: Unit) -> tuple[float, float]:
    """Return factor and offset from one unit of a quantity to another.

    >>> conversion(UNITS["psi"], UNITS["kpa"])
    (6.894757, 0.0)
    """
    return source.factor / target.factor, (source.offset - target.offset) / target.factor
