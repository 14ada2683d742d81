"""Results that later runs use again, kept in the user's cache folder.

The folder is ``o2-monitor`` in ``$XDG_CACHE_HOME``, or in ``~/.cache`` (XDG Base Directory
Specification). It may be deleted at any time.
"""

import os
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from training.jobs.checkpoints import Checkpoints
from training.jobs.values import Named

KEPT: Final = 30  # files of one kind; the oldest go first


def cache(kind: str, identity: Any, named: Named | None = None) -> Checkpoints:
    """Return the results kept for an identity; none are kept where the folder cannot be written.

    kind : of results, a folder's name
    identity : JSON tree of all that the results depend on
    """
    folder = _home() / "o2-monitor" / kind
    try:
        folder.mkdir(parents=True, exist_ok=True)
        kept = sorted(folder.iterdir(), key=lambda path: path.stat().st_mtime)
    except OSError:
        return Checkpoints()
    for path in kept[:-KEPT]:
        with suppress(OSError):
            path.unlink()
    return Checkpoints.of(folder, identity, named) if os.access(folder, os.W_OK) else Checkpoints()


def _home() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
