"""Units of loggers and the way from one to another: base = factor * value + offset."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of a quantity, relative to the quantity's base unit."""

    quantity: str
    factor: float = 1.0
    offset: float = 0.0


_PRESSURE: Final = {  # kPa
    "kpa": 1.0,
    "pa": 1e-3,
    "psi": 6.894757,
    "psia": 6.894757,
    "psig": 6.894757,
    "bar": 100.0,
    "mbar": 0.1,
    "hpa": 0.1,
    "mpa": 1000.0,
    "inhg": 3.386389,
    "mmhg": 0.1333224,
    "atm": 101.325,
    "kg/cm2": 98.0665,
    "kg/cm²": 98.0665,
}
_SPEED: Final = {"km/h": 1.0, "kph": 1.0, "kmh": 1.0, "mph": 1.609344, "m/s": 3.6}
_FLOW: Final = {  # kg/h
    "kg/h": 1.0,
    "kg/hr": 1.0,
    "g/s": 3.6,
    "g/sec": 3.6,
    "gram/s": 3.6,
    "grams/sec": 3.6,
    "grams/s": 3.6,
    "gm/s": 3.6,
    "lb/min": 27.215542,
    "lbs/min": 27.215542,
    "kg/s": 3600.0,
}
_TIME: Final = {  # s
    "s": 1.0,
    "sec": 1.0,
    "secs": 1.0,
    "seconds": 1.0,
    "ms": 1e-3,
    "msec": 1e-3,
    "us": 1e-6,
    "µs": 1e-6,
    "μs": 1e-6,
    "min": 60.0,
    "h": 3600.0,
    "millisec": 1e-3,
    "milliseconds": 1e-3,
    "ns": 1e-9,
}
_OTHER: Final = {
    "speed of rotation": {
        "1/min": 1.0,
        "rpm": 1.0,
        "rev/min": 1.0,
        "r/min": 1.0,
        "min-1": 1.0,
        "hz": 60.0,
    },
    "share": {"%": 1.0, "percent": 1.0, "pct": 1.0},
    "voltage": {"v": 1.0, "volt": 1.0, "volts": 1.0, "mv": 1e-3},
    "current": {"ma": 1.0, "a": 1000.0, "µa": 1e-3},
    "mass": {"mg": 1.0, "mg/stroke": 1.0, "mg/cyl": 1.0, "g": 1000.0, "g/stroke": 1000.0},
    "load": {"g/rev": 1.0, "mg/rev": 1e-3},
    "torque": {"nm": 1.0, "n·m": 1.0, "lbft": 1.355818, "lb-ft": 1.355818, "ft-lb": 1.355818},
}

UNITS: Final[dict[str, Unit]] = {
    **{name: Unit("pressure", factor) for name, factor in _PRESSURE.items()},
    **{name: Unit("speed", factor) for name, factor in _SPEED.items()},
    **{name: Unit("flow", factor) for name, factor in _FLOW.items()},
    **{name: Unit("time", factor) for name, factor in _TIME.items()},
    **{
        name: Unit(quantity, factor)
        for quantity, names in _OTHER.items()
        for name, factor in names.items()
    },
    **{name: Unit("temperature") for name in ("c", "°c", "degc", "celsius")},
    **{name: Unit("temperature", 1 / 1.8, -32 / 1.8) for name in ("f", "°f", "degf", "fahrenheit")},
    "k": Unit("temperature", 1.0, -273.15),
    "kelvin": Unit("temperature", 1.0, -273.15),
    **{name: Unit("lambda") for name in ("lambda", "λ", "-")},
}
AFR: Final = (
    "afr",
    "afrgasoline",
    ":1",
    "a/f",
    "air/fuel",
    "o2",
)  # lambda = value / stoichiometric ratio


def unit_of(text: str, stoich_afr: float) -> Unit | None:
    """Return the unit that a logger calls ``text``, None if it is none that is known.

    >>> unit_of("PSI", 14.7).quantity, unit_of("AFR", 14.7).quantity, unit_of("bits", 14.7)
    ('pressure', 'lambda', None)
    """
    name = text.strip().casefold().replace(" ", "").rstrip(".")
    if name in AFR:
        return Unit("lambda", 1.0 / stoich_afr)
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
