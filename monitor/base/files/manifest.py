"""Manifests: a ``manifest.json`` beside recordings says where they come from.

A result about simulated recordings must say that they are simulated; a replay reads that here.
"""

import json
from pathlib import Path
from typing import Any, Final

from monitor.base.errors import RecordingError
from monitor.base.files.inputs import read_small
from monitor.base.files.outputs import write_text

NAME: Final = "manifest.json"
SCHEMA: Final = "o2mon.manifest/1"
_MOST_BYTES: Final = 64 << 20  # 100,000 recordings take 40 MB


def load(folder: Path) -> dict[str, dict[str, Any]]:
    """Return a folder's manifest entries by file name.

    The result is empty if the folder has no manifest of schema ``SCHEMA``.
    """
    try:
        tree = json.loads(read_small(folder / NAME, _MOST_BYTES))
    except (OSError, ValueError, RecursionError):
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


def source_of(path: Path, sha256: str) -> str | None:
    """Return the source of a recording; None if no manifest names this file with this sha256."""
    entry = load(path.parent).get(path.name)
    if entry is None or entry.get("sha256") != sha256:
        return None
    source = entry.get("source")
    return str(source) if source else None


def _is_ours(path: Path) -> bool:
    return f'"{SCHEMA}"' in path.read_text(errors="replace")
