"""Units of loggers and the way from one to another: base = factor * value + offset."""

import re
import unicodedata
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of a quantity, relative to the quantity's base unit."""

    quantity: str
    factor: float = 1.0
    offset: float = 0.0


# the names of each unit by quantity and factor; the base unit has the factor 1
_NAMES: Final[dict[str, dict[float, str]]] = {
    "pressure": {
        1.0: "kpa kilopascal кпа",
        1e-3: "pa",
        0.1: "mbar hpa millibar мбар",
        100.0: "bar бар",
        1000.0: "mpa",
        6.894757: "psi",
        3.386389: "inhg",
        0.1333224: "mmhg torr",
        101.325: "atm",
        98.0665: "kg/cm2 kgf/cm2",
    },
    "speed": {
        1.0: "km/h kph kmh kmph km/std kilometerperhour kilometperhour км/ч км/год",
        1.609344: "mph mi/h miles/h",
        3.6: "m/s",
        1.852: "knots knot kts",
    },
    "flow": {
        1.0: "kg/h kg/hr kgh kgph kg/std кг/ч",
        3.6: "g/s g/sec gram/s grams/sec grams/s gm/s gps г/с",
        3600.0: "kg/s",
        60.0: "kg/min",
        0.06: "g/min",
        0.0036: "mg/s",
        0.001: "g/h",
        27.21554: "lb/min lbs/min lb/m",
        0.4535924: "lb/h lb/hr lbs/h lbs/hr pph",
    },
    "volume flow": {
        1.0: "l/h lph l/hr l/std liter/h",
        0.06: "ml/min cc/min ccm cm3/min",
        3.6: "ml/s cc/s cm3/s",
        0.0036: "ul/s mm3/s μl/s",
        3.785412: "gal/h gph gal/hr",
    },
    "time": {1.0: "s sec secs seconds с сек sn 秒", 1e-3: "ms msec millisec milliseconds мс"}
    | {60.0: "min", 3600.0: "h", 86400.0: "day days", 1e-6: "us μs", 1e-9: "ns"},
    "speed of rotation": {
        1.0: "1/min /min u/min rpm rev/min r/min min-1 min^-1 upm tr/min umin rev/minute umdr/min "
        "minutinver об/мин об/хв obr/min giri/min varv/min omw/min ot/min dev/dk d/dk",
        60.0: "hz 1/s rps u/s rev/s",
        9.549297: "rad/s",
    },
    "share": {1.0: "% percent pct prozent proz", 0.1: "‰ permille promille"},
    "voltage": {1.0: "v volt volts vdc в", 1e-3: "mv millivolt"},
    "current": {1.0: "ma", 1000.0: "a", 1e-3: "μa"},
    "mass": {
        1.0: "mg mg/stroke mg/stk mg/str mg/cyl mg/hub mg/zyl mg/inj mg/asp mg/cycle",
        1000.0: "g g/stroke g/stk g/cyl g/hub",
    },
    "volume": {1.0: "mm3 mm3/stk mm3/stroke mm3/hub ul μl mm^3/stroke"},
    "load": {1.0: "g/rev", 1e-3: "mg/rev"},
    "torque": {
        1.0: "nm n·m n.m n*m n-m newtonmeter newtometer",
        1.355818: "lbft lb-ft lb*ft ftlb ft-lb lbfft",
    },
    "temperature": {
        1.0: "c °c celsius cel gradc gradcelsius grdc degreecelsius degrecelsi degreescelsius °с"
    },
    "lambda": {1.0: "lambda λ - la lam lambdas ratio none unitless factor bit bool boolean flag"},
    "phi": {1.0: "phi φ er eqr"},
    "another": {
        1.0: "km m mm w kw hp ps ohm kohm degkw degca l ml kg count counts g/km l/100km "
        "mpg mw j kj n kn km/l month year hour minute second ca degbtdc m/s2 m/s^2 deg/s kwh "
        "ah %/s nm/s"
    },
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
UNITS.update(dict.fromkeys(("k", "kelvin", "degk", "°k"), Unit("temperature", 1.0, -273.15)))
STANDARD_KPA: Final = 101.325  # of the air, above which a gauge counts
for _name, _unit in [each for each in UNITS.items() if each[1].quantity == "pressure"]:
    UNITS.update(dict.fromkeys((f"{_name}{text}" for text in ("a", "abs", "absolute")), _unit))
    _counted = Unit("pressure", _unit.factor, STANDARD_KPA)
    UNITS.update(dict.fromkeys((f"{_name}{text}" for text in ("g", "gauge", "rel")), _counted))
# lambda = value / stoichiometric
AFR: Final = ("afr", "afrgasoline", ":1", "a/f", "air/fuel", "o2", "kg/kg", "g/g", "af", "afratio")
# stoichiometric ratio of the fuel that a unit names
FUELS: Final = {
    "e85": 9.8,
    "ethanol": 9.0,
    "methanol": 6.5,
    "diesel": 14.5,
    "lpg": 15.5,
    "cng": 17.2,
}
_SCALED: Final = re.compile(r"[x×*]?(1/)?(10*|0?\.0*1)[x×*]?(\D+)")  # 1/100 s, x1000 rpm


def unit_of(text: str, stoich_afr: float) -> Unit | None:
    """Return the unit that a logger calls ``text``, None if it is none that is known.

    >>> unit_of("PSI", 14.7).quantity, unit_of("AFR", 14.7).quantity, unit_of("bits", 14.7)
    ('pressure', 'lambda', None)
    """
    with suppress(UnicodeError):  # UTF-8 that was read as Windows text
        text = text.encode("cp1252").decode("utf-8")
    name = unicodedata.normalize("NFKC", text.replace("º", "°")).casefold()
    name = re.sub(r"unit_|[\s\[\](){}_]", "", name).rstrip(".")
    name = re.sub(r"^[a-z]+:(?=.)", "", name)  # "pressure:kPa" of ECU makers
    if name in AFR:
        return Unit("lambda", 1.0 / stoich_afr)
    fuel = name.removeprefix("afr").strip("()[]-_:")
    if fuel in FUELS:
        return Unit("lambda", 1.0 / FUELS[fuel])
    if len(name) > 1 and name[-1] in "cf" and not name[:-1].isalnum() and not name[:-1].isascii():
        name = f"°{name[-1]}"  # a degree sign that an encoding has spoilt
    if name.startswith("deg") and name[-1:] in ("c", "f"):
        name = f"°{name[-1]}"
    scaled = _SCALED.fullmatch(name)
    if name in UNITS or not scaled or scaled[3] not in UNITS:
        return UNITS.get(name)
    unit, scale = UNITS[scaled[3]], float(scaled[2])
    return replace(unit, factor=unit.factor * (1.0 / scale if scaled[1] else scale))


def conversion(source: Unit, target: Unit) -> tuple[float, float]:
    """Return factor and offset from one unit of a quantity to another.

    >>> conversion(UNITS["psi"], UNITS["kpa"])
    (6.894757, 0.0)
    """
    return source.factor / target.factor, (source.offset - target.offset) / target.factor
