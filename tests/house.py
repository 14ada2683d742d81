"""The budget of the house: lines per room, words of the docs, settings that decide.

    python -m tests.house            fails where a budget of ``[tool.house]`` is exceeded
    python -m tests.house --table    prints each part's size and budget

A budget may be lowered in any commit. It is raised in a commit of its own whose message says what
the lines buy.
"""

import json
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from monitor.model.model_file import read

ROOT: Final = Path(__file__).resolve().parents[1]
PACKAGES: Final = ("monitor", "training")  # counted room by room
WHOLE: Final = ("benchmarks", "tests")
NO_SETTINGS: Final = {"frames", "faults.toml", "findings.toml", "vocabulary.toml"}
SHIPPED: Final = ROOT / "monitor" / "model" / "shipped.onnx"


def main(argv: list[str]) -> int:
    """Compare every size with its budget; return 1 if one is exceeded."""
    budgets = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"].get("house", {})
    measured = sizes(ROOT)
    if argv == ["--table"]:
        for name, size in measured.items():
            print(f"{name:24}{size:8}{budgets.get(name, 0):8}")
    faults = over(measured, budgets)
    for fault in faults:
        print(fault, file=sys.stderr)
    return 1 if faults else 0


def over(measured: dict[str, int], budgets: dict[str, int]) -> list[str]:
    """Return a line for each size above its budget or without one.

    >>> over({"monitor/base": 11, "words": 5}, {"monitor/base": 10, "words": 5})
    ['house: monitor/base has 11, its budget in pyproject.toml is 10']
    """
    return [
        f"house: {name} has {size}, its budget in pyproject.toml is {budgets.get(name, 0)}"
        for name, size in measured.items()
        if size > budgets.get(name, 0)
    ]


def sizes(root: Path) -> dict[str, int]:
    """Return lines of Python by package and room, words of all docs, settings and card limits."""
    measured = {}
    for package in PACKAGES:
        measured[package] = _lines(root / package)
        rooms = (each for each in sorted((root / package).iterdir()) if _is_room(each))
        measured.update({f"{package}/{room.name}": _lines(room) for room in rooms})
    measured.update({folder: _lines(root / folder) for folder in WHOLE})
    pages = [*root.glob("*.md"), *root.glob("docs/**/*.md")]
    measured["words of docs"] = sum(len(page.read_text().split()) for page in pages)
    for package in PACKAGES:
        files = [f for f in (root / package).rglob("*.toml") if not NO_SETTINGS & {*f.parts}]
        settings = [key for f in files for key in _settings(tomllib.loads(f.read_text()))]
        measured[f"settings of {package}"] = len(settings)
    measured["limits of a card"] = len(json.loads(read(SHIPPED).card)["limits"])
    return measured


def _lines(folder: Path) -> int:
    return sum(len(file.read_text().splitlines()) for file in folder.rglob("*.py"))


def _is_room(path: Path) -> bool:
    return path.is_dir() and any(path.rglob("*.py"))


def _settings(table: dict[str, Any]) -> Iterator[str]:
    """Yield the keys that hold a value; a value beside its bounds is one setting."""
    for key, value in table.items():
        if isinstance(value, dict) and "value" not in value:
            yield from _settings(value)
        else:
            yield key


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
