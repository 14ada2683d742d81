"""A folder with the results of one run; the same run, begun again, goes on there."""

import ast
import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final

from monitor.base.errors import UsageError
from monitor.base.outputs import write_text

RUN: Final = "run.json"


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
    differs = list(dict.fromkeys(changed))
    if differs:
        raise UsageError(
            f"{folder}: holds a run with another {' and another '.join(differs)}; choose another "
            "--out, or remove it"
        )


def identity_of(folder: Path) -> dict[str, Any]:
    """Return all that the results in a folder depend on."""
    found: dict[str, Any] = json.loads((folder / RUN).read_text())
    return found


def write_json(path: Path, tree: Any, indent: int | None = None) -> None:
    """Write a file in one step, so that it is never there in part; raises ValueError for NaN."""
    write_text(path, json.dumps(tree, indent=indent, allow_nan=False) + "\n")


def code_sha256(paths: Iterable[Path], root: Path) -> str:
    """Return the digest of names and contents of files below ``root``."""
    digest = hashlib.sha256()
    for path in sorted(paths):
        digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()


def sources(module: Path, root: Path) -> set[Path]:
    """Return the files of a module and of all modules below ``root`` that it imports, directly
    or through others.
    """
    found, new = set[Path](), {module}
    while new:
        path = new.pop()
        found.add(path)
        new |= {each for each in _imported(path, root) if each not in found}
    return found


def _imported(path: Path, root: Path) -> Iterator[Path]:
    """Yield the files of the modules below ``root`` that a file names in its imports."""
    for name in _names(path.read_text()):
        stem = root.joinpath(*name.split("."))
        yield from (p for p in (stem.with_suffix(".py"), stem / "__init__.py") if p.is_file())


@cache  # one process may begin many runs
def _names(source: str) -> frozenset[str]:
    """Return the modules that a source imports, and all that it imports from modules."""
    names = set[str]()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return frozenset(names)
