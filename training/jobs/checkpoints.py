"""Checkpoints of a long run: the result of each stage, from which a repeated run goes on."""

import hashlib
import json
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

    def done(self, name: str, kind: type[T], make: Callable[[], T]) -> T:
        """Return a stage's result: the stored one of the same run, else that of ``make``.

        kind : type of the result; a stored result that is damaged or of another type is made anew
        """
        if self.folder is None:
            return make()
        path = self._path(self.folder, name)
        with suppress(FileNotFoundError, ValuesError):
            found: T = values.load(path, kind, self.named)
            return found
        result = make()
        self.folder.mkdir(parents=True, exist_ok=True)
        values.save(path, result, kind, self.named)
        return result

    def _path(self, folder: Path, name: str) -> Path:
        return folder / f"{name}_{self.key}.npz"

    def clear(self) -> None:
        """Remove the results of all runs in the folder."""
        if self.folder is not None and self.folder.exists():
            for path in list(self.folder.iterdir()):
                if path.suffix in SUFFIXES:
                    path.unlink()
            self.folder.rmdir()
