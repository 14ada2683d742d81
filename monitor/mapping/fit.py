"""How well a signal of a database, or a column of a table, fits a quantity.

The evidence is of four kinds, the same for both: the words of the name, the unit, the range that
the signal can carry, and the values of a recording. Each may lower the confidence. A doubt keeps
the signal a comment, or the column unused, until a person confirms it.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import dropwhile, pairwise
from operator import attrgetter
from textwrap import shorten
from typing import Any, Final

import numpy as np

from monitor.base.counts import plain
from monitor.base.signals import plausible_range
from monitor.base.types import FloatArray
from monitor.frames.profiles.profile import STOICH_AFR
from monitor.frames.units import UNITS, Unit, conversion, unit_of
from monitor.mapping.vocabulary import QUANTITIES, VOCABULARY, WORDS, MapQuantity, match, words_of

SURE: Final = 0.6  # a signal of this confidence is proposed
ASSUMED: Final = 0.85  # confidence that is left without a unit, or where only the message says it
DOUBTED: Final = 0.6  # after a doubt
OTHER_NAME: Final = 0.4  # after one of name, unit or values: no rival
ANY: Final = (-1e30, 1e30)  # range of a float
GASOLINE_KG_L: Final = 0.745
FEW: Final = 20  # values that say nothing
MOST_ABOVE: Final = 100.0  # times the plausible range; a stated range beyond has another unit
TEMPERATURE_OFFSETS: Final = frozenset({-40.0, -48.0, -50.0, -60.0})  # of degC alone
MOST_RPM: Final = 20_000.0  # few engines' signals reach so high
SEVERAL: Final = frozenset({"flow", "mass", "torque", "speed"})  # whose values suit several units
UNSTATED: Final[dict[str, list[tuple[str, Unit]]]] = {  # likely units of a kind
    "pressure": [(t, UNITS[t.lower()]) for t in ("kPa", "MPa", "bar", "hPa", "psi", "inHg")],
    "temperature": [(text, UNITS[text.lower()]) for text in ("°C", "°F")],
    "share": [("", UNITS["%"]), ("", Unit("share", 100.0))],
    "lambda": [("", UNITS["-"]), ("AFR", Unit("lambda", 1.0 / STOICH_AFR))],
}
_PREFIX_LETTERS: Final = 4  # of an ECU's abbreviation, before "_" or ".", that may begin a name
_ROLES: Final = dict.fromkeys(("other", "target"), 1.0)
_MEANT: Final = dict.fromkeys(VOCABULARY["concepts"].keys() - {"engine", "ecu"}, 1.0)
_SAYS: Final = {name: re.compile(text) for name, text in VOCABULARY["patterns"].items()}


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
        known = self.known
        return (float(known.min()), float(known.max())) if len(known) else self.stated

    @property
    def known(self) -> FloatArray:
        """Return the values that are numbers."""
        return np.empty(0) if self.values is None else self.values[np.isfinite(self.values)]


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
    def doubt(self) -> str:
        """Return why it is not proposed, "" if it is."""
        return "; ".join(self.doubts) or "not sure enough" * (self.confidence < SURE)

    def judged(self, why: str, weight: float = 1.0, **more: Any) -> "QuantityFit":
        """Return the fit with one more reason, its confidence times ``weight``."""
        confidence = min(1.0, self.confidence * weight)
        return replace(self, confidence=confidence, why=(*self.why, why), **more)

    def doubted(self, why: str, weight: float = DOUBTED) -> "QuantityFit":
        """Return the fit with one more doubt."""
        return self.judged(why, weight, doubts=(*self.doubts, why))

    def canonical(self, values: FloatArray) -> FloatArray:
        """Return values in the canonical unit, the shape kept."""
        with np.errstate(divide="ignore"):
            scaled = values * self.factor + self.offset
            return 1.0 / scaled if self.is_phi else scaled


def fit_of(name: str, d: Description, *, is_named: bool = False) -> QuantityFit | None:
    """Return how well something fits a quantity, None if it is another one.

    Where no unit is stated, it is the one in which range and values fit best.

    is_named : its name is known to mean the quantity
    """
    quantity = QUANTITIES[name]
    named = QuantityFit(1.0) if is_named else _by_name(quantity, d)
    read = _readings(quantity, d, named) if named else ()
    ranged = (_by_range(quantity, d, each) for each in read)
    judged = (_by_values(quantity, d, each) for each in ranged if each)
    return max(judged, key=attrgetter("confidence"), default=None)


def _by_name(quantity: MapQuantity, d: Description) -> QuantityFit | None:
    """Return the fit of the words."""
    words = words_of(d.name)
    sure, rest = match(quantity.phrases, words)
    why = f"its name says {d.name}"
    if not sure and (quantity.is_flag or quantity.one_sensor):
        both, rest = match(quantity.phrases, words + words_of(d.message))
        rest = [word for word in words if word in rest]
        if len(rest) < len(words):
            sure, why = ASSUMED * both, f"its name and message say {d.message} {d.name}"
    unit = unit_of(d.unit, STOICH_AFR) if quantity.name == "lambda_measured" else None
    if unit and unit.quantity == "lambda" and unit.factor != 1.0:  # no other sensor has this unit
        told = [w for w in (rest if sure else words) if w not in WORDS["noise"]]
        rest = [w for w in told if len(w) > 2 or match(_ROLES, (w,))[0]]
        sure, why = max(sure, SURE), why if sure else f"its unit is {d.unit}"
    if not sure:
        return None
    fit = QuantityFit(sure, (why,))
    for doubt in _doubts(quantity, d, words, rest):
        fit = fit.doubted(doubt, OTHER_NAME)
    return _of_one_sensor(quantity, d, fit) if quantity.one_sensor else fit


def _doubts(
    quantity: MapQuantity, d: Description, words: tuple[str, ...], rest: list[str]
) -> Iterator[str]:
    """Yield why a name may not say the quantity: by a word that the quantity does not explain."""
    first = next(iter(words), "")[:_PREFIX_LETTERS]  # perhaps an ECU's, which says nothing
    is_apart = re.match(rf"{first}\d*[_.]", d.name.lower()) and not match(_MEANT, (first,))[0]
    if is_apart and not WORDS["bare"].issuperset(words[1:]):
        rest = [*dropwhile(lambda word: word == first or word.isdigit(), rest)]
    told = quantity.also.union(*(text.split("/") for text in _own_units(quantity, words)))
    yield from [f"its name says {word!r}, too" for word in rest if word not in told][:1]
    texts = f"{d.name} {d.message}", *map(" ".join, (words_of(d.message), words)), d.unit
    said = "{} {} / {} / {}".format(*texts).lower()
    for row in VOCABULARY["doubts"]:
        is_meant = quantity.name in row.get("of", quantity.name)
        found = re.search(row["says"].replace("{bare}", "|".join(WORDS["bare"])), said)
        if is_meant and found and found[1] not in quantity.also:
            yield row["why"].format(found[1])


def _of_one_sensor(quantity: MapQuantity, d: Description, fit: QuantityFit) -> QuantityFit:
    """Return the fit, doubted if name, message or comment are of another sensor."""
    texts = [(text, " ".join(words_of(text))) for text in (d.message, d.name, d.comment)]
    for text, words in texts:
        if found := _SAYS["other_sensor"].search(_SAYS["upstream"].sub("", words)):
            why = f"says {found[0]!r}: not the upstream sensor of bank 1?"
            return fit.doubted(f"{shorten(text, 60, placeholder='...')} {why}", OTHER_NAME)
    if any(_SAYS["upstream"].search(words) for _, words in texts):
        return fit.judged("it is said to be upstream", 1.1, is_upstream=True)
    is_said = quantity.name != "lambda_measured"
    return fit if is_said else fit.judged("nothing says whether it is upstream: check")


def _readings(quantity: MapQuantity, d: Description, fit: QuantityFit) -> Iterator[QuantityFit]:
    """Yield the fit with each way to the canonical unit; a stated unit is a constraint."""
    kind, unit = quantity.unit.quantity, unit_of(d.unit, STOICH_AFR)
    said = _own_units(quantity, words_of(d.name)) if d.unit in ("", "-") else {}
    word, unit = next(iter(said.items()), ("", unit))
    if unit is None and d.unit:
        yield fit.doubted(f"its unit {d.unit!r} is not known", OTHER_NAME)
    elif quantity.is_flag:
        yield from [_flag(quantity, d, fit)] if unit in (None, UNITS["-"]) else []
    elif quantity.name == "lambda_controller":
        yield from _trims(d, unit, fit)
    elif unit is None or unit == UNITS["-"]:
        yield from _assumed(quantity, d, fit)
    elif kind == "lambda" and unit.quantity == "phi":
        yield fit.judged("an equivalence ratio: lambda is 1 / it", is_phi=True)
    elif unit.quantity in (kind, quantity.volume):
        if unit.quantity == quantity.volume:
            unit = Unit(kind, unit.factor * GASOLINE_KG_L)
        factor, offset = conversion(unit, quantity.unit)
        afr = f", divided by {1 / factor:g}: check what it counts with" * (kind == "lambda")
        why = f"its unit is {word or d.unit}{afr}"
        named = (word or d.unit) if unit != quantity.unit else ""
        yield fit.judged(why, factor=factor, offset=offset, unit=named)


def _own_units(quantity: MapQuantity, words: tuple[str, ...]) -> dict[str, Unit]:
    """Return the units of the quantity that a name's words say, alone or two as in ``kg_s``."""
    texts = (word for word in (*words, *map("/".join, pairwise(words))) if word != "o2")
    found = ((text, unit_of(text, STOICH_AFR)) for text in texts)
    kinds = (quantity.unit.quantity, "phi" if quantity.unit == UNITS["-"] else "")
    return {text: u for text, u in found if u and u.quantity in kinds and u != UNITS["-"]}


def _assumed(quantity: MapQuantity, d: Description, fit: QuantityFit) -> Iterator[QuantityFit]:
    """Yield the fit in each unit that is usual, doubted unless its range or values bear it out.

    Of the speeds, flows, masses and torques of an engine, several units are likely.
    """
    kind, low, high = quantity.unit.quantity, *d.span
    is_plain = (
        kind == "lambda"
        or (kind == "temperature" and {d.carried[0], d.stated[0]} & TEMPERATURE_OFFSETS)
        or (kind == "speed of rotation" and low >= 0.0 and high <= MOST_RPM)
    )
    why = "no unit is given, taken for the one that its range suggests: check"
    reads = []
    for text, unit in UNSTATED.get(kind, [("", quantity.unit)]):
        factor, offset = conversion(unit, quantity.unit)
        read = fit.judged(why, ASSUMED, factor=factor, offset=offset, unit=text)
        reads.append(fit if unit == UNITS["-"] else read)
    middles = [float(np.median(read.canonical(d.known))) for read in reads if len(d.known)]
    low, high = quantity.usual
    likely = [each for each, middle in zip(reads, middles, strict=False) if low <= middle <= high]
    low, high = quantity.typical
    is_told = is_plain or len(likely) < 2 or low <= middles[0] <= high
    units = "" if is_told else f": {' or '.join(read.unit for read in likely)}?"
    for read in reads:
        is_borne_out = kind not in SEVERAL and is_told and read in likely
        yield read if is_plain or is_borne_out else read.doubted(f"no unit is given{units}")


def _flag(quantity: MapQuantity, d: Description, fit: QuantityFit) -> QuantityFit:
    """Return the fit of a flag, which is turned round where 1 stands for the contrary."""
    rest = match(quantity.phrases, words_of(d.name) + words_of(d.message))[1]
    if WORDS["contrary"] & {d.choices.get(1, ""), *set(rest).intersection(words_of(d.name))}:
        fit = fit.judged("turned round", 0.8, factor=-1.0, offset=1.0)
    many = d.span[1] > 1.0 and d.carried[1] > 3.0 and not d.choices
    return fit.doubted("more than two values without a meaning") if many else fit


def _trims(d: Description, unit: Unit | None, fit: QuantityFit) -> Iterator[QuantityFit]:
    """Yield the fit of a trim that is 1, 0 or 100 where nothing is corrected."""
    kind = unit.quantity if unit else ""
    if kind in ("", "lambda"):
        yield fit.judged("1 is no correction")
        yield fit.judged("0 is no correction", offset=1.0)
    if kind == "share" or (not kind and d.values is not None):
        yield fit.judged("0 is no correction", factor=0.01, offset=1.0)
        yield fit.judged("never negative, so 100 is no correction", factor=0.01)


def _by_range(quantity: MapQuantity, d: Description, fit: QuantityFit) -> QuantityFit | None:
    """Return the fit, doubted if the stated range is odd, None if it is another quantity's."""
    (low, high), step = quantity.typical, abs(d.step * fit.factor)
    carried, stated = (
        sorted(end * fit.factor + fit.offset for end in ends) for ends in (d.carried, d.stated)
    )
    if quantity.is_flag or fit.is_phi:
        return fit
    if not carried[0] <= low < high <= carried[1] or step > (high - low) / 3:
        return None
    if d.stated != d.carried and max(stated) > MOST_ABOVE * plausible_range(quantity.name)[1]:
        fit = fit.doubted(f"its range reaches {plain(max(stated), 6)}: another unit?")
    if not stated[0] <= low < high <= stated[1]:
        span = f"{plain(stated[0], 6)} to {plain(stated[1], 6)}"
        fit = fit.doubted(f"its range {span} does not hold {low:g} to {high:g}")
    is_signed = np.isclose(sum(d.stated), -d.step)  # by its type
    if quantity.unit == UNITS["kpa"] and ANY[0] < d.stated[0] < 0.0 and not is_signed:
        fit = fit.doubted(f"its range begins at {plain(stated[0], 6)} kPa: a gauge pressure?")
    return fit


def _by_values(quantity: MapQuantity, d: Description, fit: QuantityFit) -> QuantityFit:
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
    if quantity.name not in WORDS["varying"] or len(inside) < FEW:
        return fit
    if np.ptp(inside) == 0.0:
        return fit.doubted("never moves")
    (low, high), middle = quantity.usual, float(np.median(values))
    fuel = " (another fuel?)" * (quantity.name == "lambda_measured")
    odd = f"unusual: its median is {plain(middle)}{fuel}"
    return fit if low <= middle <= high else fit.doubted(odd)
