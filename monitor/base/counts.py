"""Numbers with their nouns."""


def counted(n: int, noun: str) -> str:
    """Return a number with its noun, in the plural if it is not one.

    >>> counted(1, "error"), counted(2, "error")
    ('1 error', '2 errors')
    """
    return f"{n} {noun}{'' if n == 1 else 's'}"
