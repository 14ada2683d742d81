"""Nothing of the product reads objects with code inside from a file."""

import ast
from pathlib import Path

from tests.conftest import ROOT

# Processes of one user send each other objects; nothing of them is kept in a folder.
BETWEEN_PROCESSES = {"training/jobs/cluster.py"}
UNSAFE = {"pickle", "cloudpickle", "dill", "shelve", "marshal", "read_pickle", "to_pickle"}


def unsafe_words(path: Path) -> set[str]:
    """Return the words in a file's code that read or write objects with code inside."""
    words = set[str]()
    for node in ast.walk(ast.parse(path.read_text())):
        match node:
            case ast.Import(names=names):
                words |= {each.name.split(".")[0] for each in names} & UNSAFE
            case ast.ImportFrom(module=str(module)):
                words |= {module.split(".")[0]} & UNSAFE
            case ast.Attribute(value=ast.Name(id="joblib" | "torch" as package), attr="load"):
                words.add(f"{package}.load")
            case ast.Attribute(attr=word):
                words |= {word} & UNSAFE
            case ast.keyword(arg="allow_pickle", value=value):
                allowed = not isinstance(value, ast.Constant) or bool(value.value)
                words |= {"allow_pickle"} if allowed else set()
    return words


def test_no_package_reads_pickled_objects_from_a_file() -> None:
    files = [path for package in ("monitor", "training") for path in (ROOT / package).rglob("*.py")]
    found = {path.relative_to(ROOT).as_posix() for path in files if unsafe_words(path)}
    assert found == BETWEEN_PROCESSES
