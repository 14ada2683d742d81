"""Checkpoints of a long run: the result of each stage, from which a repeated run goes on."""

import hashlib
import json
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")
Progress = Callable[[str], None]  # called with a line of text


@dataclass(frozen=True, slots=True)
class Checkpoints:
    """A folder with the results of stages, or no folder; results of another run are ignored."""

    folder: Path | None = None
    key: str = ""

    @classmethod
    def of(cls, folder: Path, identity: Any) -> "Checkpoints":
        """Return the checkpoints of a run; ``identity`` is a JSON tree of all its settings."""
        text = json.dumps(identity, sort_keys=True)
        return cls(folder, hashlib.sha256(text.encode()).hexdigest()[:16])

    def done(self, name: str, make: Callable[[], T]) -> T:
        """Return a stage's result: the stored one of the same run, else that of ``make``."""
        if self.folder is None:
            return make()
        path = self.folder / f"{name}_{self.key}.pickle"
        if path.exists():
            found: T = pickle.loads(path.read_bytes())
            return found
        result = make()
        self.folder.mkdir(parents=True, exist_ok=True)
        begun = path.with_suffix(".begun")
        begun.write_bytes(pickle.dumps(result))
        begun.replace(path)
        return result

    def clear(self) -> None:
        """Remove the results of all runs in the folder."""
        if self.folder is not None and self.folder.exists():
            for path in [*self.folder.glob("*.pickle"), *self.folder.glob("*.begun")]:
                path.unlink()
            self.folder.rmdir()
