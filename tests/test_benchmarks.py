"""The benchmarks name only what the project has, and the runner finds them all."""

import ast
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

from benchmarks.__main__ import FOLDER, benchmarks, main

SCRIPTS = sorted(FOLDER.rglob("*.py"))
OURS = {"monitor", "training", "dbc", "tests", "benchmarks"}


def imported(script: Path) -> Iterator[tuple[str, list[str]]]:
    """Give each module that a script imports, with the names that it takes from it."""
    for node in ast.walk(ast.parse(script.read_text())):
        if isinstance(node, ast.Import):
            yield from ((each.name, []) for each in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or "", [each.name for each in node.names]


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_a_benchmark_imports_what_there_is(script: Path) -> None:
    for name, wanted in imported(script):
        if name.partition(".")[0] not in OURS or name.startswith("benchmarks"):
            continue
        module = import_module(name)
        gone = [each for each in wanted if not hasattr(module, each)]
        assert not [each for each in gone if find_spec(f"{name}.{each}") is None], name


def test_the_runner_lists_each_benchmark_in_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    listed = capsys.readouterr().out
    for name, (_, purpose) in benchmarks().items():
        assert purpose
        assert any(name in line and purpose in line for line in listed.splitlines())


def test_an_unknown_benchmark_ends_with_exit_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["no_such"]) == 2
    assert "no_such" in capsys.readouterr().err
