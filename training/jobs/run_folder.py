"""A folder with the results of one run; the same run, begun again, goes on there."""

import hashlib
import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final

import monitor
import training
from monitor.base.errors import UsageError
from monitor.base.files.outputs import write_text

RUN: Final = "run.json"
PACKAGES: Final = (monitor, training)


def claim(folder: Path, identity: Mapping[str, Any]) -> None:
    """Write into the folder which run it holds; ``identity`` is all that its results depend on.

    Raises UsageError if the folder holds another run.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / RUN
    if not path.exists():
        write_json(path, identity, indent=1)
        return
    found = json.loads(path.read_text())
    changed = (key.removesuffix("_sha256") for key in identity if found.get(key) != identity[key])
    if differs := list(dict.fromkeys(changed)):
        raise UsageError(
            f"{folder}: holds a run with another {' and another '.join(differs)}; choose another "
            "--out, or remove it"
        )


def write_json(path: Path, tree: Any, indent: int | None = None) -> None:
    """Write a file in one step, so that it is never there in part; raises ValueError for NaN."""
    write_text(path, json.dumps(tree, indent=indent, allow_nan=False) + "\n")


@cache
def code_sha256(*more: Path) -> str:
    """Return the digest of all code and numbers of the product, and of the folders ``more``."""
    digest = hashlib.sha256()
    for folder in (*(Path(str(each.__file__)).parent for each in PACKAGES), *more):
        for path in sorted(p for p in folder.rglob("*") if p.suffix in (".py", ".toml")):
            digest.update(path.relative_to(folder.parent).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()
