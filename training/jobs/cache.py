"""Files that later runs use again, in the user's cache folder.

The folder is ``o2-monitor`` in ``$XDG_CACHE_HOME``, or in ``~/.cache`` (XDG Base Directory
Specification). It may be deleted at any time.
"""

import hashlib
import json
import os
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

KEPT: Final = 30  # files of one kind; the oldest go first


def cached(kind: str, identity: Any) -> Path | None:
    """Return the place of the file for an identity; None where the folder cannot be written.

    kind : of files, a folder's name
    identity : JSON tree of all that the content depends on
    """
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = home / "o2-monitor" / kind
    try:
        folder.mkdir(parents=True, exist_ok=True)
        kept = sorted(folder.iterdir(), key=lambda path: path.stat().st_mtime)
    except OSError:
        return None
    for path in kept[:-KEPT]:
        with suppress(OSError):
            path.unlink()
    text = json.dumps(identity, sort_keys=True)
    name = f"{hashlib.sha256(text.encode()).hexdigest()[:16]}.json"
    return folder / name if os.access(folder, os.W_OK) else None
