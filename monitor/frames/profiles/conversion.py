"""Values of a logger's column in the unit of the canonical signal."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from monitor.base.signals import BY_NAME, plausible_range
from monitor.base.types import FloatArray
from monitor.frames.profiles.profile import Profile, Source
from monitor.frames.profiles.recognition import key, keys_of
from monitor.frames.tables.cells import is_no_value
from monitor.frames.tables.dialect import name_and_unit
from monitor.frames.tables.raw_table import RawColumn, RawTable
from monitor.frames.units import Unit, conversion, unit_of

_OF_UNITS: Final = re.compile(r"[/%°]|[x×*] ?10")  # in brackets, where words may stand, too
_WORDS: Final = re.compile(r"\S{2,}")


@dataclass(frozen=True, slots=True)
class Choice:
    """A column that may carry a signal."""

    name: str
    source: Source
    column: int


def target_of(name: str, stoich_afr: float) -> Unit | None:
    """Return the unit of a canonical signal, None if loggers have none for it."""
    return unit_of(BY_NAME[name].unit, stoich_afr)


def in_one_setting(
    raw: RawTable, profile: Profile, columns: Sequence[tuple[Choice, FloatArray]]
) -> list[Choice]:
    """Return the choices with one unit each; where it is a setting of the logger, alike for all.

    Units of mixture are one setting; all others are another: metric or not. The one counts with
    which most columns that state no unit are plausible.
    """
    place = dict[bool, int]()
    for is_mixture in (False, True):
        open_ = [
            (choice, cells)
            for choice, cells in columns
            if len(choice.source.units) > 1
            and _is_mixture(choice) == is_mixture
            and not stated_unit(raw.columns[choice.column], profile.stoich_afr)
        ]
        most = max((len(choice.source.units) for choice, _ in open_), default=1)
        votes = [sum(_fits(profile, *each, i) for each in open_) for i in range(most)]
        place[is_mixture] = votes.index(max(votes))
    units = [choice.source.units[: place[_is_mixture(choice)] + 1][-1:] for choice, _ in columns]
    return [
        replace(choice, source=replace(choice.source, units=unit))
        for (choice, _), unit in zip(columns, units, strict=True)
    ]


def _is_mixture(choice: Choice) -> bool:
    return any(text.casefold() in ("afr", "lambda") for text in choice.source.units)


def _fits(profile: Profile, choice: Choice, cells: FloatArray, place: int) -> bool:
    """Return whether a unit gives plausible values."""
    source, target = choice.source, target_of(choice.name, profile.stoich_afr)
    unit = unit_of(source.units[min(place, len(source.units) - 1)], profile.stoich_afr)
    if unit is None or target is None or not np.isfinite(cells).any():
        return True
    low, high = plausible_range(choice.name)
    middle = float(np.nanmedian(scaled(cells, unit, target) * source.factor + source.offset))
    return low <= middle <= high


def stated_texts(column: RawColumn) -> tuple[str, ...]:
    """Return the texts with which a file states a column's unit."""
    texts = column.unit, name_and_unit(column.name)[1]
    return tuple(text for text in texts if not (is_no_value(text) or text == "deg"))  # of what?


def stated_unit(column: RawColumn, stoich_afr: float) -> str:
    """Return the unit that a file states; of others in a name, those that look like one."""
    texts = stated_texts(column)
    known = [text for text in texts if unit_of(text, stoich_afr)]
    odd = [
        text
        for text in texts
        if text == column.unit
        or _OF_UNITS.search(text)
        or any(unit_of(word, stoich_afr) for word in _WORDS.findall(text))
    ]
    return next(iter((*known, *odd)), "")


def is_of_quantity(name: str, source: Source, column: RawColumn, stoich_afr: float) -> bool:
    """Return whether a column may carry a signal: no unit that it states is of another quantity.

    A unit that is not known counts as another one, and so does any text behind a name that is
    known without it.
    """
    target = target_of(name, stoich_afr)
    if source.is_flag or target is None or source.factor != 1.0:  # the profile converts
        return True
    units = [unit_of(text, stoich_afr) for text in stated_texts(column)]
    if any(units):
        return any(unit is not None and unit.quantity == target.quantity for unit in units)
    whole, bare = keys_of(column.name)
    return not (stated_unit(column, stoich_afr) or bare == key(source.column) != whole)


def may_be_absolute(source: Source, column: RawColumn, cells: FloatArray) -> bool:
    """Return whether a column known as a gauge's may hold absolute pressures.

    A gauge's fall to the air's and below it, save in a pull; no engine reaches that of a vacuum.
    """
    units = [unit_of(text, 1.0) for text in (stated_unit(column, 1.0), *source.units)]
    unit, (least_kpa, _) = next(filter(None, units), None), plausible_range("manifold_pressure_kpa")
    lowest = float(np.nanmin(cells, initial=np.inf))
    return bool(source.offset and unit and not unit.offset and lowest * unit.factor >= least_kpa)


def scaled(cells: FloatArray, unit: Unit, target: Unit) -> FloatArray:
    """Return values in another unit of the same quantity."""
    factor, offset = conversion(unit, target)
    return cells if factor == 1.0 and offset == 0.0 else cells * factor + offset


def converted(profile: Profile, choice: Choice, column: RawColumn, cells: FloatArray) -> FloatArray:
    """Return the values in the signal's unit."""
    target = target_of(choice.name, profile.stoich_afr)
    texts = (*stated_texts(column), *choice.source.units)
    known = [unit for text in texts if (unit := unit_of(text, profile.stoich_afr))]
    units = [unit for unit in known if target and unit.quantity == target.quantity]
    if target is None or not units:
        return cells
    unit = units[0]
    if unit.quantity == "pressure":  # a gauge's is counted from the air once, whoever says so
        unit = replace(unit, offset=0.0 if choice.source.offset else max(u.offset for u in units))
    return scaled(cells, unit, target)
