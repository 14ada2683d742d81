"""Numbers as text: a missing value is a dash, and a number never parts from its unit."""

import math
from decimal import Decimal
from typing import Any, Final

from monitor.base.counts import TINY, plain

NBSP: Final = "\N{NO-BREAK SPACE}"
MISSING: Final = "–"


def form(value: float | None, spec: str) -> str:
    """Return a number by a format specification, a dash for a missing one.

    >>> form(0.12345, ".2f"), form(None, ".2f")
    ('0.12', '–')
    """
    return MISSING if value is None or math.isnan(value) else format(value, spec)


def fixed(value: float | None, digits: int) -> str:
    """Return a number with so many decimals."""
    return form(value, f".{digits}f")


def short(value: float | None, digits: int = 4) -> str:
    """Return a number with so many significant digits, its whole part in full, no exponent.

    >>> short(0.00000051234), short(1.703e-12), short(123456.0), short(12345.6, 3)
    ('0.0000005123', 'less than 0.000000001', '123,456', '12,346')
    """
    if value is None or not math.isfinite(value):
        return form(value, "g")
    text = plain(value, digits)
    return f"less than {TINY:.9f}" if text == "0" and value else f"{Decimal(text):,f}"


def p_value(p: float) -> str:
    """Return a p-value with as many digits as a reader needs."""
    return "below 0.001" if p < 0.001 else f"{p:.3f}" if p < 0.1 else f"{p:.2f}"


def signed(value: float | None, digits: int) -> str:
    """Return a number with its sign and so many decimals."""
    return form(value, f"+.{digits}f")


def count(value: int) -> str:
    """Return a count with separators.

    >>> count(12345)
    '12,345'
    """
    return f"{value:,}"


def separated(value: Any) -> Any:
    """Return a whole number as a count, anything else as it is: what pages do with every value."""
    return count(value) if type(value) is int else value


def percent(share: float | None, digits: int = 0, sign: str = "") -> str:
    """Return a share in percent.

    sign : "+" shows the sign of a change, too

    >>> percent(0.1234, 1).replace(NBSP, " "), percent(0.02, sign="+").replace(NBSP, " ")
    ('12.3 %', '+2 %')
    """
    text = form(None if share is None else 100.0 * share, f"{sign}.{digits}f")
    return text if text == MISSING else f"{text}{NBSP}%"


def with_unit(name: str, unit: str | None) -> str:
    """Return a name with its unit, as an axis is labelled; a dash or nothing is no unit.

    >>> with_unit("level", "m"), with_unit("lambda", "-")
    ('level [m]', 'lambda')
    """
    return f"{name} [{unit}]" if unit and unit != "-" else name


def unit_of(unit: str | None) -> str:
    """Return a unit as a cell shows it: nothing for a number without one."""
    return "" if not unit or unit == "-" else unit


def words(name: str) -> str:
    """Return a name of the code in words: without underscores."""
    return name.replace("_", " ")


def unbroken(text: str) -> str:
    """Return a text that no line break parts."""
    return text.replace(" ", NBSP).replace("-", "\N{NON-BREAKING HYPHEN}")
