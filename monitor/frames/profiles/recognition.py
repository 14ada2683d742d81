"""Which profile a raw table belongs to, by its columns and the text before them.

A user's own profiles come first: those beside the log, then those in the user's folder.
"""

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from monitor.frames.profiles.profile import (
    Profile,
    Recognition,
    is_profile,
    load_profile,
    shipped,
    shipped_profile,
)
from monitor.frames.tables.dialect import name_and_unit
from monitor.frames.tables.raw_table import RawTable

OWN_FOLDER: Final = "O2_PROFILES"  # environment variable: a folder of own profiles
MOST_OWN: Final = 100  # profiles of a folder that are tried


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
    """Return the profile that fits best, an own one before a shipped one; or None.

    Of several in one place the one counts that names most of the table.
    Raises ConfigError if an own profile cannot be used.
    """
    there = places(raw.names)
    for folder in (raw.path.parent, own_folder()):
        best = _best(_own(folder), there, raw.preamble)
        if best is not None:
            return best
    return _best(map(shipped_profile, shipped()), there, raw.preamble)


def own_folder() -> Path:
    """Return the folder of a user's own profiles, which need not exist."""
    given = os.environ.get(OWN_FOLDER)
    if given:
        return Path(given)
    config = os.environ.get("XDG_CONFIG_HOME")
    return (Path(config) if config else Path.home() / ".config") / "o2-monitor" / "profiles"


def _own(folder: Path) -> Iterator[Profile]:
    """Yield the profiles in a folder that say which files they are for."""
    try:
        paths = sorted(folder.glob("*.toml"))
    except OSError:
        return
    for path in paths[:MOST_OWN]:
        if is_profile(path):
            profile = load_profile(path)
            if profile.recognise:
                yield profile


def _best(profiles: Iterable[Profile], there: dict[str, int], preamble: str) -> Profile | None:
    """Return the profile that names most of the table, None if none fits."""
    best: tuple[int, Profile] | None = None
    for profile in profiles:
        score = max((_score(each, there, preamble) for each in profile.recognise), default=0)
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
