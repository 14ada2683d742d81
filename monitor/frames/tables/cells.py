"""Cells of a text table: numbers with points or commas, clock times, words, and no value."""

import math
import re
from collections.abc import Callable
from datetime import datetime, timezone
from typing import Final

from monitor.frames.tables.raw_table import DAY_S, HOUR_S

NO_VALUE: Final = frozenset(
    {"", "-", "--", "---", "∞", "-∞", "+∞", "nan", "n/a", "na", "#n/a", "null", "none", "no data"}
    | {"inf", "-inf", "infinity", "-infinity", "?", "*", "err", "error", "nodata"}
)
WORDS: Final = dict.fromkeys(("true", "on", "yes", "active", "high", "ok"), 1.0) | dict.fromkeys(
    ("false", "off", "no", "inactive", "low"), 0.0
)

# h:m:s or m:s, with or without a date before it and an offset from UTC after it
_CLOCK: Final = re.compile(
    r"(?:(.*\S)[T ] ?)?(?:(\d{1,3}):)?(\d{1,2}):(\d{1,2}(?:[.,]\d*)?)\s*(?:([ap]m)\s*)?"
    r"(?:Z|([+-]\d\d):?(\d\d)?)?",
    re.I,
)
_DATES: Final = ["%Y-%m-%d", "%Y/%m/%d", "%d.%m.%Y", "%m/%d/%Y", "%d-%b-%Y", "%d/%m/%Y", "%Y%m%d"]

Parse = Callable[[str], float]


def is_plain(text: str) -> bool:
    """Return whether a text has nothing that Python reads as a number and no logger writes.

    >>> is_plain("1_0"), is_plain("٣"), is_plain("-1.5e3")
    (False, False, True)
    """
    return "_" not in text and text.isascii()


def numeral(text: str) -> float:
    """Return a cell's number; raises ValueError if it is none."""
    if not is_plain(text):
        raise ValueError(f"{text[:40]!r} is no number")
    return float(text)


def exact_number(text: str) -> float:
    """Return a cell's number, NaN for a blank one; raises ValueError for text."""
    return numeral(text) if text.strip() else math.nan


def number(text: str) -> float:
    """Return a cell's number, NaN for no value and for text."""
    try:
        value = numeral(text)
    except ValueError:
        return WORDS.get(text.strip().casefold(), math.nan)
    return value if math.isfinite(value) else math.nan


def number_with_comma(text: str) -> float:
    """Return the number of a cell such as 0,38.

    >>> number_with_comma("-1.234,5")
    -1234.5
    """
    if "," in text:
        text = text.replace(".", "").replace(",", ".")
    return number(text)


def is_number(text: str, *, comma: bool = False) -> bool:
    """Return whether a cell holds a number."""
    try:
        numeral(text.replace(",", ".") if comma else text)
    except ValueError:
        return False
    return True


def is_no_value(text: str) -> bool:
    """Return whether a cell says that there is no value."""
    return text.strip().casefold() in NO_VALUE


def clock(text: str) -> float:
    """Return the seconds of a clock time, since midnight, the hour, or 1970 with a date.

    NaN if it is none.

    >>> clock("25:36.7"), clock("16:37:18.5"), clock("1970-01-02T02:00:01+02:00")
    (1536.7, 59838.5, 86401.0)
    """
    match = _CLOCK.fullmatch(text.strip())
    if match is None:
        return math.nan
    day, hours, minutes, seconds, half, ahead, further = match.groups()
    value = HOUR_S * int(hours or 0) + 60.0 * int(minutes) + float(seconds.replace(",", "."))
    if half:
        value = value % (DAY_S / 2) + (DAY_S / 2 if half.casefold() == "pm" else 0.0)
    if day and ahead:
        value -= HOUR_S * int(ahead) + 60.0 * int(f"{ahead[0]}{further or 0}")
    return value + (_day_s(day) if day else 0.0)


def _day_s(text: str) -> float:
    for form in _DATES:
        try:
            return datetime.strptime(text, form).replace(tzinfo=timezone.utc).timestamp()  # noqa: UP017
        except ValueError:
            continue
    return 0.0


def wrap_s(text: str) -> float:
    """Return after how many seconds the clock of a cell starts again, 0 never."""
    rest = text.strip().replace("T", " ")
    if re.match(r".*\d[-/.]\w+[-/.]\d.* ", rest):
        return 0.0
    return DAY_S if rest.count(":") >= 2 else HOUR_S


def of_words(words: tuple[str, ...]) -> Parse:
    """Return a parser: 1 for a cell that holds one of the words, 0 for other text."""
    folded = tuple(word.casefold() for word in words)

    def parse(text: str) -> float:
        cell = text.strip().casefold()
        if cell in NO_VALUE:
            return math.nan
        return float(any(word in cell for word in folded))

    return parse
