"""Manifests: a ``manifest.json`` beside recordings says where they come from.

A result about simulated recordings must say that they are simulated; the manifest is how a replay
knows.
"""

import json
from pathlib import Path
from typing import Any, Final

from monitor.errors import RecordingError

NAME: Final = "manifest.json"
SCHEMA: Final = "o2mon.manifest/1"


def load(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the entries of a folder's manifest by file name; {} where there is none.

    Raises RecordingError if the manifest cannot be read.
    """
    path = folder / NAME
    try:
        tree = json.loads(path.read_text())
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise RecordingError(f"{path}: not a manifest: {error}") from None
    if not isinstance(tree, dict) or tree.get("schema") != SCHEMA:
        raise RecordingError(f"{path}: not a manifest of schema {SCHEMA}")
    return {entry["file"]: entry for entry in tree["recordings"]}


def save(folder: Path, entries: dict[str, dict[str, Any]]) -> None:
    """Write a folder's manifest, sorted by file name."""
    ordered = [entries[name] for name in sorted(entries)]
    text = json.dumps({"schema": SCHEMA, "recordings": ordered}, indent=1)
    (folder / NAME).write_text(text + "\n")


def source_of(path: Path, sha256: str) -> str | None:
    """Return where a recording comes from, None if no manifest speaks of this very file."""
    entry = load(path.parent).get(path.name)
    if entry is None or entry.get("sha256") != sha256:
        return None
    return str(entry["source"])
