"""Cells of a text table: numbers with points or commas, clock times, words, and no value."""

import math
import re
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from typing import Final

from monitor.frames.tables.raw_table import DAY_S, HOUR_S
from monitor.frames.units import conversion, unit_of

NO_VALUE: Final = frozenset(
    {"", "-", "--", "---", "∞", "-∞", "+∞", "nan", "n/a", "na", "#n/a", "null", "none", "no data"}
    | {"inf", "-inf", "infinity", "-infinity", "?", "*", "err", "error", "nodata"}
)
WORDS: Final = dict.fromkeys(("true", "on", "yes", "active", "high", "ok"), 1.0) | dict.fromkeys(
    ("false", "off", "no", "inactive", "low"), 0.0
)

# h:m:s, h:m:s:ms or m:s, with or without a date before it, a zone, its offset and a year after it
_CLOCK: Final = re.compile(
    r"(?:(.*\S)[T ] ?|\d+\.)?(?:(\d{1,3}):)?(\d{1,2}):(\d{1,2}(?:[.,]\d*)?)(?::(\d{3,6}))?\s*"
    r"(?:([ap])\.?\s?m\.?\s*)?(?:Z|UTC|GMT|MES?Z|[A-Z]{1,3}T)?\s*(?:([+-]\d\d?):?(\d\d)?)?"
    r"(?:\s+(\d{4}))?(?:\s*\(.*\))?",
    re.I,
)
# 20261128T063000.5, and points in a clock behind a date
_BASIC: Final = re.compile(r"(\d\d(?:\d{6}|(?! )))[T_ ](\d\d)(\d\d)(\d\d)[.,]?(\d*)")
_POINTS: Final = re.compile(r"(\d),? (\d\d?)\.(\d\d)\.(\d\d)[.,]?(\d*)")
_IN_WORDS: Final = re.compile(r"(\d{1,3}) ?h ?(\d\d?) ?m(?:in)? ?([\d.,]+) ?s(?:ec)?", re.I)
_DATES: Final = ["%Y-%m-%d", "%Y/%m/%d", "%d.%m.%Y", "%m/%d/%Y", "%d-%b-%Y", "%d/%m/%Y", "%Y%m%d"]

_GERMAN: Final = {"mär": "mar", "mrz": "mar", "mai": "may", "okt": "oct", "dez": "dec"}
THOUSANDS: Final = re.compile(r"-?\d{1,3}(?:,\d{3})+(?:\.\d*)?")  # 1,700

# 14.7 AFR
_MEASURE: Final = re.compile(r"\s*([-+]?\d[\d.,]*)\s*([^\d.,:;\s-](?:\D*[^\d\s])?)\s*")

Parse = Callable[[str], float]


def is_plain(text: str) -> bool:
    """Return whether a text has nothing that Python reads as a number and no logger writes.

    >>> is_plain("1_0"), is_plain("٣"), is_plain("-1.5e3")
    (False, False, True)
    """
    return "_" not in text and text.isascii()


def numeral(text: str, *, comma: bool = False) -> float:
    """Return a cell's number; raises ValueError if it is none.

    comma : of decimals

    >>> numeral("1,700"), numeral("-1.234,5", comma=True), numeral("\u22122.5")
    (1700.0, -1234.5, -2.5)
    """
    text = text.replace("\u2212", "-")  # as text programs write it
    if not is_plain(text):
        raise ValueError(f"{text[:40]!r} is no number")
    if comma and "," in text:
        text = text.replace(".", "").replace(",", ".")
    return float(text.replace(",", "") if THOUSANDS.fullmatch(text.strip()) else text)


def exact_number(text: str) -> float:
    """Return a cell's number, NaN for a blank one; raises ValueError for text."""
    return numeral(text) if text.strip() else math.nan


def number(text: str, *, comma: bool = False) -> float:
    """Return a cell's number, NaN for no value and for text."""
    try:
        value = numeral(text, comma=comma)
    except ValueError:
        return WORDS.get(text.strip().casefold(), math.nan)
    return value if math.isfinite(value) else math.nan


def is_number(text: str, *, comma: bool = False) -> bool:
    """Return whether a cell holds a number."""
    try:
        numeral(text, comma=comma)
    except ValueError:
        return False
    return True


def measure(text: str) -> tuple[str, str]:
    """Return number and unit of a cell, all of it and "" if it is no number with a known unit.

    >>> measure("3.2 V"), measure("90°C"), measure("3 of 5")
    (('3.2', 'V'), ('90', '°C'), ('3 of 5', ''))
    """
    match = None if text[-1:].isdigit() else _MEASURE.fullmatch(text)
    return (match[1], match[2]) if match and unit_of(match[2], 1.0) else (text, "")


def is_no_value(text: str) -> bool:
    """Return whether a cell says that there is no value."""
    return text.strip().casefold() in NO_VALUE


class ColumnClock:
    """A column's clock times; days are read in the order that makes the smallest steps.

    >>> clock = ColumnClock()
    >>> clock("12/11/2026 23:59:59") - clock("13/11/2026 00:00:00")
    -1.0
    """

    def __init__(self) -> None:
        self._day, self._day_s = "", 0.0

    def __call__(self, text: str) -> float:
        """Return the seconds of a cell, since midnight, the hour, or 1970 with a date; or NaN."""
        match = _clock_match(text)
        if match is None:
            return math.nan
        day, hours, minutes, seconds, fraction, half, ahead, further, year = match.groups()
        value = HOUR_S * int(hours or 0) + 60.0 * int(minutes) + float(seconds.replace(",", "."))
        value += float(f"0.{fraction or 0}")
        if half:
            value = value % (DAY_S / 2) + (DAY_S / 2 if half in "pP" else 0.0)
        day = f"{day} {year}" if day and year else day
        if day and ahead:
            value -= HOUR_S * int(ahead) + 60.0 * int(f"{ahead[0]}{further or 0}")
        if day and day != self._day:
            self._turn(day)
        return value + (self._day_s if day else 0.0)

    def _turn(self, day: str) -> None:
        before, after = _readings(self._day), _readings(day)
        steps = [after[form] - before[form] for form in after if form in before]
        if self._day:
            self._day_s += min(steps or [DAY_S], key=abs)  # one that cannot be read: the next
        else:
            self._day_s = next(iter(after.values()), 0.0)
        self._day = day


def _readings(day: str) -> dict[str, float]:
    """Return the seconds since 1970 by each form of a date that fits."""
    words, numbers = re.findall(r"[^\W\d]{3,}", day), re.findall(r"\d+", day)
    if words and len(numbers) == 2:  # Sat, 28-Nov.-2026; Mo 1. März 2026; Nov 28 2026
        month, (number, year) = words[-1][:3].casefold(), sorted(numbers, key=len)
        day = f"{number}-{_GERMAN.get(month, month)}-{year}"
    found = {}
    for form in _DATES:
        with suppress(ValueError):
            found[form] = datetime.strptime(day, form).replace(tzinfo=UTC).timestamp()
    return found


def clock(text: str) -> float:
    """Return the seconds of a single cell, as ``ColumnClock`` does.

    >>> clock("25:36.7"), clock("1970-01-02T02:00:01+02:00"), clock("2-Dez.-1970 0h 25m 36.7s")
    (1536.7, 86401.0, 28945536.7)
    """
    return ColumnClock()(text)


def wrap_s(text: str) -> float:
    """Return after how many seconds the clock of a cell starts again, 0 never."""
    match = _clock_match(text)
    if match is None or (match[1] and _readings(match[1])):
        return 0.0
    return DAY_S if match[2] else HOUR_S


def _clock_match(text: str) -> re.Match[str] | None:
    text = _IN_WORDS.sub(r"\1:\2:\3", text.strip())
    for form in (_BASIC, _POINTS) if text.count(":") < 1 else ():
        text = form.sub(r"\1 \2:\3:\4.\5", text, count=1)
    return _CLOCK.fullmatch(text)


def of_unit(unit: str, parse: Parse) -> Parse:
    """Return a parser of cells that end in a unit; it converts those in another of its quantity.

    It raises ValueError for a unit of another quantity, and for AFR beside lambda: whose fuel?

    >>> of_unit("V", float)("850 mV")
    0.85
    """
    own = unit_of(unit, math.inf)
    assert own

    def parsed(text: str) -> float:
        value, said = measure(text)
        other = unit_of(said or unit, math.inf)
        if other == own:
            return parse(value)
        if other is None or other.quantity != own.quantity or own.quantity == "lambda":
            raise ValueError(said)
        factor, offset = conversion(other, own)
        return parse(value) * factor + offset

    return parsed


def of_words(words: tuple[str, ...]) -> Parse:
    """Return a parser: 1 for a cell that holds one of the words, 0 for other text."""
    folded = tuple(word.casefold() for word in words)

    def parse(text: str) -> float:
        if is_no_value(text):
            return math.nan
        return float(any(word in text.casefold() for word in folded))

    return parse
