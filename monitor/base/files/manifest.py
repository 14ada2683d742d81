"""Manifests: a ``manifest.json`` beside recordings says where they come from.

A result about simulated recordings must say that they are simulated; a replay reads that here. By
its sha256 here a command knows a recording that it made: a frame log has no place for a mark.
"""

import hashlib
import json
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from monitor.base.errors import RecordingError
from monitor.base.files.inputs import read_small
from monitor.base.files.outputs import is_stream, write_text

NAME: Final = "manifest.json"
SCHEMA: Final = "o2mon.manifest/1"
_MOST_BYTES: Final = 64 << 20  # 100,000 recordings take 40 MB
_KEPT: Final = ("source", "fault", "severity", "in_the_loop")  # in the entry of a copy


def load(folder: Path) -> dict[str, dict[str, Any]]:
    """Return a folder's manifest entries by file name.

    The result is empty if the folder has no manifest of schema ``SCHEMA``.
    """
    try:
        known = (folder / NAME).stat()
        return dict(_entries(folder / NAME, known.st_mtime_ns, known.st_size))
    except OSError:
        return {}


@lru_cache(maxsize=4)  # each table of a fleet's folder asks for it
def _entries(path: Path, _mtime_ns: int, _size: int) -> dict[str, dict[str, Any]]:
    try:
        tree = json.loads(read_small(path, _MOST_BYTES))
    except (ValueError, RecursionError):
        return {}
    if not isinstance(tree, dict) or tree.get("schema") != SCHEMA:
        return {}
    entries = tree.get("recordings")
    valid = [e for e in entries if isinstance(e, dict)] if isinstance(entries, list) else []
    return {str(entry.get("file")): entry for entry in valid}


def save(folder: Path, entries: dict[str, dict[str, Any]]) -> None:
    """Write a folder's manifest, sorted by file name.

    Raises RecordingError if a ``manifest.json`` with another schema exists.
    """
    if (folder / NAME).exists() and not _is_ours(folder / NAME):
        raise RecordingError(f"{folder / NAME}: is not a manifest of recordings, and in the way")
    ordered = [entries[name] for name in sorted(entries)]
    text = json.dumps({"schema": SCHEMA, "recordings": ordered}, indent=1)
    write_text(folder / NAME, text + "\n")
    _entries.cache_clear()


def note(path: Path, origin: Path, **more: object) -> None:
    """Name a recording made of another in the manifest beside it, with what is known of that one.

    more : replaces what the other's entry says. Another program's ``manifest.json`` stays as it is.
    """
    if is_stream(path) or ((path.parent / NAME).exists() and not _is_ours(path.parent / NAME)):
        return
    known = {key: value for key, value in entry_of(origin).items() if key in _KEPT}
    entry = known | more | {"file": path.name, "sha256": sha256_of(path)}
    save(path.parent, load(path.parent) | {path.name: entry})


def entry_of(path: Path, sha256: str = "") -> dict[str, Any]:
    """Return what the manifest says of a recording, {} if it does not name this content.

    sha256 : of the file, by default read from it
    """
    entry = load(path.parent).get(path.name, {})
    return entry if entry and entry.get("sha256") == (sha256 or sha256_of(path)) else {}


def sha256_of(path: Path) -> str:
    """Return the sha256 of a file.

    Raises RecordingError if it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise RecordingError(f"{path}: {error.strerror}") from None


def _is_ours(path: Path) -> bool:
    return f'"{SCHEMA}"' in path.read_text(errors="replace")
