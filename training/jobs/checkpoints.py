"""Checkpoints of a long run: the result of each stage, from which a repeated run goes on."""

import hashlib
import json
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeVar

from training.jobs import values
from training.jobs.values import Named, ValuesError

T = TypeVar("T")
Progress = Callable[[str], None]  # called with a line of text
SUFFIXES: Final = (".npz", ".begun")
KEPT: Final = 30  # files of one kind in the cache; the oldest go first


@dataclass(frozen=True, slots=True)
class Checkpoints:
    """A folder with the results of stages, or no folder; results of another run are ignored.

    named : types that are stored by name, see ``values``
    """

    folder: Path | None = None
    key: str = ""
    named: Named = field(default_factory=dict)

    @classmethod
    def of(cls, folder: Path, identity: Any, named: Named | None = None) -> "Checkpoints":
        """Return the checkpoints of a run; ``identity`` is a JSON tree of all its settings."""
        text = json.dumps(identity, sort_keys=True)
        return cls(folder, hashlib.sha256(text.encode()).hexdigest()[:16], named or {})

    @classmethod
    def kept(cls, kind: str, identity: Any, named: Named | None = None) -> "Checkpoints":
        """Return results that later runs use again, in the user's cache folder.

        kind : of results, a folder's name in ``o2-monitor`` of ``$XDG_CACHE_HOME`` or ``~/.cache``
            (XDG Base Directory Specification), which may be deleted at any time
        Nothing is kept where the folder cannot be written.
        """
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        folder = home / "o2-monitor" / kind
        try:
            folder.mkdir(parents=True, exist_ok=True)
            files = sorted(folder.iterdir(), key=lambda path: path.stat().st_mtime)
        except OSError:
            return cls()
        for path in files[:-KEPT]:
            with suppress(OSError):
                path.unlink()
        return cls.of(folder, identity, named) if os.access(folder, os.W_OK) else cls()

    def done(self, name: str, kind: type[T], make: Callable[[], T]) -> T:
        """Return a stage's result: the stored one of the same run, else that of ``make``.

        kind : type of the result; a stored result that is damaged or of another type is made anew
        """
        if self.folder is None:
            return make()
        path = self.folder / f"{name}_{self.key}.npz"
        with suppress(FileNotFoundError, ValuesError):
            found: T = values.load(path, kind, self.named)
            return found
        result = make()
        self.folder.mkdir(parents=True, exist_ok=True)
        values.save(path, result, self.named)
        return result

    def clear(self) -> None:
        """Remove the results of all runs in the folder."""
        if self.folder is not None and self.folder.exists():
            for path in list(self.folder.iterdir()):
                if path.suffix in SUFFIXES:
                    path.unlink()
            self.folder.rmdir()
