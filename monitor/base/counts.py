"""Numbers as people read them: without an exponent, with their nouns and units."""

from decimal import Decimal
from typing import Final

TINY: Final = 1e-9  # a smaller number is not told from 0
_WHOLE: Final = 1e15  # from here on a double has no more digits


def plain(value: float, digits: int = 4, sign: str = "") -> str:
    """Return a number with so many significant digits, its whole part in full, no exponent.

    sign : "+" shows that of a positive number, too

    >>> plain(99.7, 2), plain(123456.7), plain(0.0000123456), plain(1.7e-12), plain(0.2, 3, "+")
    ('100', '123457', '0.00001235', '0', '+0.2')
    """
    if abs(value) < TINY:
        return "0"
    text = f"{value:{sign}.{digits}g}"
    if "e" not in text or abs(value) >= _WHOLE:
        return text
    return f"{value:{sign}.0f}" if abs(value) > 1.0 else f"{Decimal(text):{sign}f}"


def counted(n: int, noun: str) -> str:
    """Return a number with its noun, in the plural if it is not one.

    >>> counted(1, "error"), counted(2, "error")
    ('1 error', '2 errors')
    """
    return f"{n} {noun}{'' if n == 1 else 's'}"


def duration(seconds: float) -> str:
    """Return a duration in seconds, minutes or hours, whichever reads best.

    >>> duration(119.0), duration(600.0), duration(115_537.0)
    ('119\\xa0s', '10\\xa0min', '32.1\\xa0h')
    """
    scale_s, unit = (1.0, "s") if seconds < 120.0 else (60.0, "min")
    scale_s, unit = (scale_s, unit) if seconds < 7200.0 else (3600.0, "h")
    return f"{plain(seconds / scale_s, 3)}\u00a0{unit}"
