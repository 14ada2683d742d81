"""How well a signal of a database, or a column of a table, fits a quantity.

The evidence is of four kinds, the same for both: the words of the name, the unit, the range that
the signal can carry, and the values of a recording. Each may lower the confidence. A doubt keeps
the signal a comment, or the column unused, until a person confirms it.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from textwrap import shorten
from typing import Any, Final

import numpy as np

from monitor.base.counts import plain
from monitor.base.signals import plausible_range
from monitor.base.types import FloatArray
from monitor.frames.units import UNITS, Unit, conversion, unit_of
from monitor.mapping.quantities import GASOLINE_KG_L, QUANTITIES, STOICHIOMETRIC, VARYING
from monitor.mapping.quantities import MapQuantity as Quantity
from monitor.mapping.words import KNOWN, OTHER, VOCABULARY, match, words_of

SURE: Final = 0.6  # a signal of this confidence is proposed
ASSUMED: Final = 0.85  # confidence that is left without a unit, or where only the message says it
DOUBTED: Final = 0.6  # after a doubt
OTHER_NAME: Final = 0.4  # after one of name, unit or values: no rival
ANY: Final = (-1e30, 1e30)  # range of a float
FEW: Final = 20  # values that say nothing
USUAL: Final = (0.7, 1.5)  # times the ends of the typical range: of the median
STILL: Final = 1e-9  # range of a signal that never moves
MOST_ABOVE: Final = 100.0  # times the plausible range; a stated range beyond has another unit
UNIT_IN_NAME: Final = frozenset({"rpm", "kph", "kmh", "mph"})
TEMPERATURE_OFFSETS: Final = frozenset({-40.0, -48.0, -50.0, -60.0})  # of degC alone
MOST_RPM: Final = 20_000.0  # few engines' signals reach so high
SEVERAL: Final = frozenset({"flow", "mass", "torque", "speed"})  # whose values suit several units
PRESSURES: Final = ("kPa", "MPa", "bar", "hPa", "psi")  # of a column without a unit
_SAYS: Final = {name: re.compile(text) for name, text in VOCABULARY["patterns"].items()}
_PREFIX_LETTERS: Final = 4  # of an ECU's abbreviation, before "_" or ".", that may begin a name
_BARE: Final = frozenset(VOCABULARY["words"]["bare"].split())
_CONTRARY: Final = frozenset(VOCABULARY["words"]["contrary"].split())


@dataclass(frozen=True, slots=True)
class Description:
    """A signal of a database, or a column of a table, as its file describes it."""

    name: str
    unit: str = ""
    message: str = ""  # name of the message
    comment: str = ""
    carried: tuple[float, float] = ANY  # what the bits can say, in ``unit``
    stated: tuple[float, float] = ANY  # the range that the file states, else ``carried``
    step: float = 0.0
    choices: Mapping[int, str] = field(default_factory=dict)
    values: FloatArray | None = None  # of a recording, in ``unit``

    @property
    def span(self) -> tuple[float, float]:
        """Return the range of the values, the stated one without a recording."""
        known = self.values[np.isfinite(self.values)] if self.values is not None else ()
        return (float(np.min(known)), float(np.max(known))) if len(known) else self.stated


@dataclass(frozen=True, slots=True)
class QuantityFit:
    """How well it fits: canonical value = factor * value + offset, or 1 / that."""

    confidence: float  # 0 to 1
    why: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    factor: float = 1.0
    offset: float = 0.0
    unit: str = ""  # taken where none is stated
    is_phi: bool = False  # the value is 1 / lambda
    is_upstream: bool = False  # said to be the sensor before the catalyst

    @property
    def stands(self) -> bool:
        """Return whether it is proposed."""
        return self.confidence >= SURE and not self.doubts

    def judged(self, why: str, weight: float = 1.0, **more: Any) -> "QuantityFit":
        """Return the fit with one more reason, its confidence times ``weight``."""
        why_all = (*self.why, why) if why else self.why
        confidence = min(1.0, self.confidence * weight)
        return replace(self, confidence=confidence, why=why_all, **more)

    def doubted(self, why: str, weight: float = DOUBTED) -> "QuantityFit":
        """Return the fit with one more doubt."""
        return self.judged(why, weight, doubts=(*self.doubts, why))

    def canonical(self, values: FloatArray) -> FloatArray:
        """Return values in the canonical unit, the shape kept."""
        with np.errstate(divide="ignore"):
            scaled = values * self.factor + self.offset
            return 1.0 / scaled if self.is_phi else scaled


def fit_of(name: str, described: Description, *, is_named: bool = False) -> QuantityFit | None:
    """Return how well something fits a quantity, None if it is another one.

    is_named : its name is known to mean the quantity
    """
    quantity = QUANTITIES[name]
    fit = QuantityFit(1.0) if is_named else _by_name(quantity, described)
    for look in (_by_unit, _by_range, _by_values):
        fit = look(quantity, described, fit) if fit else None
    return fit


def _by_name(quantity: Quantity, d: Description) -> QuantityFit | None:
    """Return the fit of the words."""
    words = words_of(d.name)
    sure, rest = match(quantity.phrases, words)
    why = f"its name says {d.name}"
    if not sure and (quantity.is_flag or quantity.one_sensor):
        both, rest = match(quantity.phrases, words + words_of(d.message))
        rest = [word for word in words if word in rest]
        if len(rest) < len(words):
            sure, why = ASSUMED * both, f"its name and message say {d.message} {d.name}"
    if quantity.name == "lambda_measured" and _afr(d, words):  # no other one has this unit
        before = dict(zip(words[1:], words, strict=False))
        own = {w for w in words if (before.get(w, "") if w.isdigit() else w) in KNOWN} - {"afr"}
        rest = [word for word in (rest if sure else words) if word in own]
        sure, why = max(sure, SURE), why if sure else f"its unit is {d.unit}"
    if not sure:
        return None
    fit = QuantityFit(sure, (why,))
    for doubt in _doubts(quantity, d, words, rest):
        fit = fit.doubted(doubt, OTHER_NAME)
    return _of_one_sensor(quantity, d, fit) if quantity.one_sensor else fit


def _doubts(
    quantity: Quantity, d: Description, words: tuple[str, ...], rest: list[str]
) -> Iterator[str]:
    """Yield why a name may not say the quantity: by a word that the quantity does not explain."""
    first, of_message = next(iter(words), ""), words_of(d.message)
    if rest[:1] == [first] and len(first) <= _PREFIX_LETTERS and first not in OTHER:
        is_apart = re.match(rf"{first}\d*[_.]", d.name.lower()) and not _BARE.issuperset(words[1:])
        if is_apart or first in of_message:  # an ECU's, which says nothing
            rest = rest[1:]
    if odd := [word for word in rest if word not in quantity.also]:
        yield f"its name says {odd[0]!r}, too"
    said = f"{d.name} {d.message} {' '.join(of_message)} / {' '.join(words)} / {d.unit}".lower()
    for row in VOCABULARY["doubts"]:
        found = re.search(row["says"].replace("{bare}", "|".join(_BARE)), said)
        if (
            found
            and quantity.name in row.get("of", quantity.name)
            and found[1] not in quantity.also
        ):
            yield row["why"].format(found[1])


def _of_one_sensor(quantity: Quantity, d: Description, fit: QuantityFit) -> QuantityFit:
    """Return the fit, doubted if name, message or comment are of another sensor."""
    texts = [(text, " ".join(words_of(text))) for text in (d.message, d.name, d.comment)]
    for text, words in texts:
        if found := _SAYS["other_sensor"].search(_SAYS["upstream"].sub("", words)):
            said = shorten(text, 60, placeholder="...")
            why = f"{said} says {found[0]!r}: not the upstream sensor of bank 1?"
            return fit.doubted(why, OTHER_NAME)
    if any(_SAYS["upstream"].search(words) for _, words in texts):
        return fit.judged("it is said to be upstream", 1.1, is_upstream=True)
    if quantity.name == "lambda_measured":
        return fit.judged("nothing says whether it is upstream: check")
    return fit


def _by_unit(quantity: Quantity, d: Description, fit: QuantityFit) -> QuantityFit | None:
    """Return the fit with the way to the canonical unit; a stated unit is a constraint."""
    unit = unit_of(d.unit, STOICHIOMETRIC)
    if unit is None and d.unit:
        return fit.doubted(f"its unit {d.unit!r} is not known", OTHER_NAME)
    if quantity.is_flag:
        return _flag(d, fit) if unit in (None, UNITS["-"]) else None
    if quantity.unit == UNITS["-"]:
        return _mixture(quantity, d, unit, fit)
    if unit is None or unit == UNITS["-"]:
        return _assumed(quantity, d, fit)
    if unit.quantity == quantity.volume:
        unit = Unit(quantity.unit.quantity, unit.factor * GASOLINE_KG_L)
    if unit.quantity != quantity.unit.quantity:
        return None
    factor, offset = conversion(unit, quantity.unit)
    return fit.judged(f"its unit is {d.unit}", factor=factor, offset=offset)


def _assumed(quantity: Quantity, d: Description, fit: QuantityFit) -> QuantityFit:
    """Return the fit in the unit that name and range suggest, doubted if they leave several."""
    (low, high), kind, text, factor = d.span, quantity.unit.quantity, "", 1.0
    if kind == "pressure":
        factors = {each: conversion(UNITS[each.lower()], quantity.unit)[0] for each in PRESSURES}
        least, most = quantity.typical[1] / 2, 2 * plausible_range(quantity.name)[1]
        likely = [each for each in PRESSURES if least <= high * factors[each] <= most]
        text, factor = (likely[0], factors[likely[0]]) if likely else ("", 1.0)
    elif kind == "share" and 0.0 < high <= 1.5:
        factor = 100.0
    elif kind == "temperature" and d.values is not None:
        return _temperature(quantity, d.values, fit)
    is_plain = (
        (d.values is not None and kind not in SEVERAL)  # which ``_by_values`` looks at
        or bool(UNIT_IN_NAME & set(words_of(d.name)))
        or (kind == "temperature" and bool({d.carried[0], d.stated[0]} & TEMPERATURE_OFFSETS))
        or (kind == "speed of rotation" and low >= 0.0 and high <= MOST_RPM)
    )
    why = "no unit is given, taken for the one that its range suggests: check"
    fit = fit.judged(why, ASSUMED, factor=factor, unit=text)
    return fit if is_plain else fit.doubted("no unit is given")


def _temperature(quantity: Quantity, values: FloatArray, fit: QuantityFit) -> QuantityFit:
    """Return the fit in the first unit in which an engine that runs has such temperatures."""
    known = values[np.isfinite(values)]
    for text in ("°C", "°F") if len(known) else ():
        factor, offset = conversion(UNITS[text.lower()], quantity.unit)
        middle = float(np.median(known)) * factor + offset
        if USUAL[0] * quantity.typical[0] <= middle < USUAL[1] * quantity.typical[1]:
            why = "no unit is given, taken for the one that its values suggest: check"
            return fit.judged(why, ASSUMED, factor=factor, offset=offset, unit=text)
    return fit.doubted("no unit is given")


def _flag(d: Description, fit: QuantityFit) -> QuantityFit:
    """Return the fit of a flag, which is turned round where 1 stands for the contrary."""
    meaning = d.choices.get(1, "")
    if _CONTRARY & {meaning, *words_of(d.name)}:
        fit = fit.judged("turned round", 0.8, factor=-1.0, offset=1.0)
    many = d.span[1] > 1.0 and d.carried[1] > 3.0 and not d.choices
    return fit.doubted("more than two values without a meaning") if many else fit


def _mixture(
    quantity: Quantity, d: Description, unit: Unit | None, fit: QuantityFit
) -> QuantityFit | None:
    """Return the fit of lambda, AFR or phi, or of a trim."""
    kind = unit.quantity if unit else "lambda"
    if quantity.name == "lambda_controller":
        return _trim(d, kind == "share", fit) if kind in ("lambda", "share") else None
    if kind not in ("lambda", "phi"):
        return None
    words = words_of(d.name)
    if kind == "phi" or {"phi", "eqr"} & {*words}:
        return fit.judged("an equivalence ratio: lambda is 1 / it", is_phi=True)
    if ratio := _afr(d, words):
        why = f"an air-fuel ratio, divided by {1 / ratio:g}: check what {d.name} counts with"
        return fit.judged(why, factor=ratio, unit="" if d.unit else "AFR")
    if "equivalence" in words and not d.unit and not {"range", "o2", "oxygen"} & {*words}:
        return fit.doubted("an equivalence ratio: lambda, as OBD has it, or 1 / lambda?")
    return fit


def _afr(d: Description, words: tuple[str, ...]) -> float:
    """Return lambda per unit of what counts in air per fuel, by unit or name, 0 if it does not."""
    unit = unit_of(d.unit, STOICHIOMETRIC)
    if unit and unit.quantity != "lambda":
        return 0.0
    if unit and unit.factor != 1.0:
        return unit.factor
    is_named = "afr" in words or {"air", "fuel"} <= {*words}
    return 1.0 / STOICHIOMETRIC if is_named and d.span[1] > 5.0 else 0.0


def _trim(d: Description, is_share: bool, fit: QuantityFit) -> QuantityFit:
    """Return the fit of a trim, 1 where nothing is corrected."""
    low, high = d.span
    if is_share and (low > 50.0 or (low >= 0.0 and high > 110.0)):
        sure = 1.0 if high <= 400.0 else 0.5  # beyond, the range is only that of the bits
        return fit.judged("never negative, so 100 is no correction", sure, factor=0.01)
    if is_share or low < 0.0 < high < 0.9:
        factor = 0.01 if is_share else 1.0
        return fit.judged("0 is no correction", factor=factor, offset=1.0)
    return fit.judged("1 is no correction")


def _by_range(quantity: Quantity, d: Description, fit: QuantityFit) -> QuantityFit | None:
    """Return the fit, doubted if the stated range is odd, None if it is another quantity's."""
    if quantity.is_flag or fit.is_phi:
        return fit
    (low, high), step = quantity.typical, abs(d.step * fit.factor)
    carried, stated = (
        sorted(end * fit.factor + fit.offset for end in ends) for ends in (d.carried, d.stated)
    )
    if not carried[0] <= low < high <= carried[1] or step > (high - low) / 3:
        return None
    if d.stated != d.carried and max(stated) > MOST_ABOVE * plausible_range(quantity.name)[1]:
        fit = fit.doubted(f"its range reaches {plain(max(stated), 6)}: another unit?")
    if not stated[0] <= low < high <= stated[1]:
        why = (
            f"its range {plain(stated[0], 6)} to {plain(stated[1], 6)} does not hold {low:g} "
            f"to {high:g}"
        )
        fit = fit.doubted(why)
    of_signed_type = np.isclose(sum(d.stated), -d.step)
    if quantity.unit == UNITS["kpa"] and ANY[0] < d.stated[0] < 0.0 and not of_signed_type:
        fit = fit.doubted(f"its range begins at {plain(stated[0], 6)} kPa: a gauge pressure?")
    return fit


def _by_values(quantity: Quantity, d: Description, fit: QuantityFit) -> QuantityFit:
    """Return the fit as the values of a recording bear it out."""
    if d.values is None:
        return fit
    values = fit.canonical(d.values[~np.isnan(d.values)])
    low, high = plausible_range(quantity.name)
    inside = values[(values >= low) & (values <= high)]
    if 2 * len(inside) <= len(values):
        seen = f"{plain(values.min())} to {plain(values.max())}" if len(values) else "no value"
        return fit.doubted(f"implausible in the recording: {seen}", OTHER_NAME)
    fit = fit.judged(f"in the recording {plain(inside.min())} to {plain(inside.max())}")
    moves, middle = np.ptp(inside) > STILL, float(np.median(inside))
    if quantity.name in VARYING and len(inside) >= FEW:
        low, high = USUAL[0] * quantity.typical[0], USUAL[1] * quantity.typical[1]
        if not moves or not low <= middle <= high:
            fuel = " (another fuel?)" * (quantity.name == "lambda_measured")
            return fit.doubted(
                f"unusual: its median is {plain(middle)}{fuel}" if moves else "never moves"
            )
    return fit.judged("", 1.05) if moves else fit
