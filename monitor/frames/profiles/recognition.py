"""Which profile a raw table belongs to, by its columns and the text before them."""

from collections.abc import Iterable

from monitor.frames.profiles.profile import Profile, Recognition, shipped, shipped_profile
from monitor.frames.tables.dialect import name_and_unit
from monitor.frames.tables.raw_table import RawTable


def key(name: str) -> str:
    """Return a column's name as names are compared: small letters and digits alone.

    >>> key("A/F Sens 1 Ratio") == key("AF Sens 1 ratio")
    True
    """
    return "".join(letter for letter in name.casefold() if letter.isalnum())


def keys_of(name: str) -> tuple[str, str]:
    """Return the two forms under which a column is found: whole, and without its unit."""
    return key(name), key(name_and_unit(name)[0])


def places(names: Iterable[str]) -> dict[str, int]:
    """Return the number of each column by its keys; the first of two columns counts."""
    found: dict[str, int] = {}
    short: dict[str, int] = {}
    for number, name in enumerate(names):
        whole, without = keys_of(name)
        found.setdefault(whole, number)
        short.setdefault(without, number)
    return {**short, **found}


def recognised(raw: RawTable) -> Profile | None:
    """Return the shipped profile that fits best: with the most columns that it names; or None."""
    there = places(raw.names)
    best: tuple[int, Profile] | None = None
    for name in shipped():
        profile = shipped_profile(name)
        score = max((_score(each, there, raw.preamble) for each in profile.recognise), default=0)
        if score and (best is None or score > best[0]):
            best = score, profile
    return best[1] if best else None


def _score(wanted: Recognition, there: dict[str, int], preamble: str) -> int:
    """Return how much of the table the recognition names, 0 if it does not fit."""
    if not all(key(column) in there for column in wanted.columns):
        return 0
    if not all(text.casefold() in preamble.casefold() for text in wanted.preamble):
        return 0
    return len(wanted.columns) + 100 * len(wanted.preamble)
