"""Results of a long run, stage by stage, so that the same run begun again goes on where it was."""

import hashlib
import json
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")
Progress = Callable[[str], None]  # is told what goes on


@dataclass(frozen=True, slots=True)
class Stages:
    """A folder of results, or none; results of another run are not taken up."""

    folder: Path | None = None
    key: str = ""

    @classmethod
    def of(cls, folder: Path, identity: Any) -> "Stages":
        """Return the stages of the run that ``identity``, a tree as JSON has it, stands for."""
        text = json.dumps(identity, sort_keys=True)
        return cls(folder, hashlib.sha256(text.encode()).hexdigest()[:16])

    def done(self, name: str, make: Callable[[], T]) -> T:
        """Return a stage's result, made now unless the same run made it before."""
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
        """Remove what is kept, all runs'."""
        if self.folder is not None and self.folder.exists():
            for path in [*self.folder.glob("*.pickle"), *self.folder.glob("*.begun")]:
                path.unlink()
            self.folder.rmdir()
