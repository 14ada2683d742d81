"""Which profile a raw table belongs to, by its columns and the text before them.

A user's own profiles come first: those beside the log, then those in the user's folder.
"""

import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Final

from monitor.base.errors import ConfigError
from monitor.frames.profiles.profile import (
    Profile,
    Recognition,
    is_profile,
    load_profile,
    shipped,
    shipped_profile,
)
from monitor.frames.tables.dialect import name_and_unit
from monitor.frames.tables.raw_table import Notes, RawTable

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


def places(raw: RawTable) -> dict[str, list[int]]:
    """Return the numbers of the columns by their keys, the best first.

    The best is a column of just that name, then one without its unit, then another name.
    """
    found: dict[str, list[int]] = {}
    ranked = (
        (rank, number, each)
        for number, column in enumerate(raw.columns)
        for rank, each in enumerate((*keys_of(column.name), *map(key, column.others)))
    )
    for _, number, each in sorted(ranked):
        if number not in found.setdefault(each, []):
            found[each].append(number)
    found.pop("", None)
    return found


def recognised(raw: RawTable, notes: Notes | None = None) -> Profile | None:
    """Return the profile that fits best, an own one before a shipped one; or None.

    notes : takes which own profiles cannot be used, and why
    Of several in one place the one counts that names most of the table.
    """
    of_user = recognised_own(raw, notes)
    return of_user or _best(map(shipped_profile, shipped()), places(raw), raw.preamble)


def recognised_own(raw: RawTable, notes: Notes | None = None) -> Profile | None:
    """Return the user's own profile that fits best, one beside the table first; or None."""
    there, notes = places(raw), notes or Notes()
    folders = (raw.path.parent, own_folder())
    found = (_best(_own(folder, notes), there, raw.preamble) for folder in folders)
    return next(filter(None, found), None)


def own_folder() -> Path:
    """Return the folder of a user's own profiles, which need not exist."""
    given = os.environ.get(OWN_FOLDER)
    if given:
        return Path(given)
    config = os.environ.get("XDG_CONFIG_HOME")
    return (Path(config) if config else Path.home() / ".config") / "o2-monitor" / "profiles"


def _own(folder: Path, notes: Notes) -> Iterator[Profile]:
    """Yield the profiles in a folder that say which files they are for; others are noted."""
    try:
        paths = sorted(folder.glob("*.toml"))
    except OSError:
        return
    for path in paths[:MOST_OWN]:
        try:
            profile = load_profile(path) if is_profile(path) else None
        except ConfigError as error:
            notes.sentences.append(f"a profile that cannot be used: {error}")
            continue
        if profile is not None and profile.recognise:
            yield profile


def _best(
    profiles: Iterable[Profile], there: Mapping[str, list[int]], preamble: str
) -> Profile | None:
    """Return the profile that names most of the table, None if none fits."""

    def score(profile: Profile) -> int:
        return max((_score(each, there, preamble) for each in profile.recognise), default=0)

    best = max(profiles, key=score, default=None)
    return best if best and score(best) else None


def _score(wanted: Recognition, there: Mapping[str, list[int]], preamble: str) -> int:
    """Return how much of the table the recognition names, 0 if it does not fit."""
    if not all(key(column) in there for column in wanted.columns):
        return 0
    if not all(text.casefold() in preamble.casefold() for text in wanted.preamble):
        return 0
    return len(wanted.columns) + 100 * len(wanted.preamble)
