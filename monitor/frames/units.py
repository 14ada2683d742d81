"""Units of loggers and the way from one to another: base = factor * value + offset."""

import re
import tomllib
import unicodedata
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Final


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of a quantity, relative to the quantity's base unit."""

    quantity: str
    factor: float = 1.0
    offset: float = 0.0


# the names of each unit with its way to the base unit, by ``units.toml``
UNITS: Final[dict[str, Unit]] = {
    name: Unit(quantity, *way)
    for quantity, units in tomllib.loads(
        files("monitor.frames").joinpath("units.toml").read_text("utf-8")
    ).items()
    for *way, names in units
    for name in names.split()
}
STANDARD_KPA: Final = 101.325  # of the air, above which a gauge counts
for _name, _unit in [each for each in UNITS.items() if each[1].quantity == "pressure"]:
    UNITS.update(dict.fromkeys((f"{_name}{text}" for text in ("a", "abs", "absolute")), _unit))
    _counted = Unit("pressure", _unit.factor, STANDARD_KPA)
    UNITS.update(dict.fromkeys((f"{_name}{text}" for text in ("g", "gauge", "rel")), _counted))
# lambda = value / stoichiometric
AFR: Final = ("afr", "afrgasoline", ":1", "a/f", "air/fuel", "o2", "kg/kg", "g/g", "af", "afratio")
_SCALED: Final = re.compile(r"[x×*]?(1/)?(10*|0?\.0*1)[x×*]?(\D+)")  # 1/100 s, x1000 rpm


def unit_of(text: str, stoich_afr: float) -> Unit | None:
    """Return the unit that a logger calls ``text``, None if it is none that is known.

    >>> unit_of("PSI", 14.7).quantity, unit_of("AFR", 14.7).quantity, unit_of("bits", 14.7)
    ('pressure', 'lambda', None)
    """
    name = unicodedata.normalize("NFKC", restored(text).replace("º", "°")).casefold()
    name = re.sub(r"unit_|[\s\[\](){}_]", "", name).rstrip(".")
    name = re.sub(r"^[a-z]+:(?=.)", "", name)  # "pressure:kPa" of ECU makers
    if name.removeprefix("estimated") in AFR:
        return Unit("lambda", 1.0 / stoich_afr)
    fuel = name.removeprefix("afr").strip("()[]-_:")
    if fuel in UNITS and UNITS[fuel].quantity == "fuel":
        return Unit("lambda", 1.0 / UNITS[fuel].factor)
    is_spoilt = not (name[:-1].isalnum() or name[:-1].isascii())  # a degree sign, by an encoding
    if name[-1:] in ("c", "f") and (is_spoilt or name.startswith("deg")):
        name = f"°{name[-1]}"
    scaled = _SCALED.fullmatch(name)
    if name in UNITS or not scaled or scaled[3] not in UNITS:
        return UNITS.get(name)
    unit, scale = UNITS[scaled[3]], float(scaled[2])
    return replace(unit, factor=unit.factor * (1.0 / scale if scaled[1] else scale))


def restored(text: str) -> str:
    """Return UTF-8 that was read as Windows text as it was meant, any other text as it is.

    >>> restored("KÃ¼hlmittel [Â°C]"), restored("Kühlmittel")
    ('Kühlmittel [°C]', 'Kühlmittel')
    """
    with suppress(UnicodeError):
        return text.encode("cp1252").decode("utf-8")
    return text


def conversion(source: Unit, target: Unit) -> tuple[float, float]:
    """Return factor and offset from one unit of a quantity to another.

    >>> conversion(UNITS["psi"], UNITS["kpa"])
    (6.894757, 0.0)
    """
    return source.factor / target.factor, (source.offset - target.offset) / target.factor
