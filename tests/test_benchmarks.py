"""The benchmarks name only what the project has; running them all would take hours."""

import ast
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parent.parent / "benchmarks"
SCRIPTS = sorted(FOLDER.glob("*.py"))
SIBLINGS = {script.stem for script in SCRIPTS}
OURS = {"monitor", "training", "dbc", "tests"}


def imported(script: Path) -> Iterator[tuple[str, list[str]]]:
    """Give each module that a script imports, with the names that it takes from it."""
    for node in ast.walk(ast.parse(script.read_text())):
        if isinstance(node, ast.Import):
            yield from ((each.name, []) for each in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or "", [each.name for each in node.names]


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_a_benchmark_imports_what_there_is(script: Path) -> None:
    modules = dict(imported(script))
    for name, wanted in modules.items():
        top = name.partition(".")[0]
        assert top != "benchmarks", f"{name}: a script imports another one by its bare name"
        if top in OURS:
            module = import_module(name)
            gone = [each for each in wanted if not hasattr(module, each)]
            assert not [each for each in gone if find_spec(f"{name}.{each}") is None], name
    # the folder of tests is no installed package
    if any(name.startswith("tests.") for name in modules):
        assert "repository" in modules or modules.keys() & SIBLINGS
