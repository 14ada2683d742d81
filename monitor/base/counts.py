"""Numbers with their nouns."""


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
    return f"{seconds / scale_s:.3g}\u00a0{unit}"
