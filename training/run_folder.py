"""A folder that holds one run's results, so that the same run begun again goes on there."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

from monitor.errors import UsageError

RUN: Final = "run.json"


def claim(folder: Path, identity: Mapping[str, Any]) -> None:
    """Say in the folder which run it holds; ``identity`` is what its results depend on.

    Raises UsageError if the folder holds another run.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / RUN
    if not path.exists():
        write_json(path, identity)
        return
    found = json.loads(path.read_text())
    differs = [key.removesuffix("_sha256") for key in identity if found.get(key) != identity[key]]
    if differs:
        raise UsageError(
            f"{folder}: holds a run with another {' and another '.join(differs)}; choose another "
            "--out, or remove it"
        )


def identity_of(folder: Path) -> dict[str, Any]:
    """Return what the results in a folder depend on."""
    found: dict[str, Any] = json.loads((folder / RUN).read_text())
    return found


def write_json(path: Path, tree: Any) -> None:
    """Write a file that is there whole or not at all."""
    begun = path.with_suffix(".begun")
    begun.write_text(json.dumps(tree, indent=1, allow_nan=False) + "\n")
    begun.replace(path)


def code_sha256(paths: Iterable[Path], root: Path) -> str:
    """Return the digest of files below ``root``, names and all."""
    digest = hashlib.sha256()
    for path in sorted(paths):
        digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()
