"""The functions of the Python API and the commands do the same where nothing is said."""

import inspect
from collections.abc import Callable
from typing import Any

import pytest

import training
from training.cli import evaluate
from training.cli.fit import FitCommand
from training.cli.gap import GapCommand
from training.cli.tables import TablesCommand
from training.narx.fit import FitOptions

NAMES = {"period_s": "period", "budget_minutes": "budget"}


def defaults(function: Callable[..., Any]) -> dict[str, Any]:
    parameters = inspect.signature(function).parameters.values()
    given = {p.name: p.default for p in parameters if p.default is not inspect.Parameter.empty}
    return {NAMES.get(name, name): default for name, default in given.items()}


@pytest.mark.parametrize(
    ("function", "command", "shared"),
    [
        (training.GapOptions, GapCommand, {"steps", "sensor_known_good", "add"}),
        (training.estimate_tables, TablesCommand, {"axes", "load", "displacement_l", "cylinders"}),
        (training.evaluate, evaluate.run, {"washout"}),
        (training.fit, FitCommand, {"kind", "inputs", "seed"}),
        (FitOptions, FitCommand, {"budget", "starts", "lags", "hidden", "seed"}),
    ],
)
def test_a_function_and_its_command_have_the_same_defaults(
    function: Callable[..., Any], command: Callable[..., Any], shared: set[str]
) -> None:
    ours, theirs = defaults(function), defaults(command)
    same = (ours.keys() & theirs.keys()) - {"output"}  # the command says it in its help
    assert shared <= same
    assert {name: ours[name] for name in same} == {name: theirs[name] for name in same}
