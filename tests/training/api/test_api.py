"""The Python API of the offline part says what the command says."""

import inspect
import json
from collections.abc import Callable
from pathlib import Path
from shutil import copy
from typing import Any

import numpy as np
import polars as pl
import pytest

import training
from monitor import O2Error, replay
from monitor.base.signals import OUTPUT
from monitor.pipeline.replay import shipped_model
from training import GapOptions, estimate_tables, evaluate, find_gap, fit, load_recordings
from training.cli import main
from training.cli.evaluate import run as run_evaluate
from training.cli.fit import FitCommand
from training.cli.gap import GapCommand
from training.cli.tables import TablesCommand
from training.narx.fit import FitOptions
from training.recordings.ecu_table import Axis, EcuTable
from training.recordings.files.table_files import write_table

INPUTS = ("fuel", "air")
QUICK = {"lags": 3, "hidden": (4,), "starts": 1, "budget_minutes": 0.05, "threads": 1}


def drive_of(seed: int, n: int = 2100) -> dict[str, np.ndarray]:
    """Return a drive of a lambda that follows two inputs with a lag, no car's."""
    rng = np.random.default_rng(seed)
    fuel = np.repeat(rng.uniform(0.0, 1.0, n // 7), 7)
    air = np.repeat(rng.uniform(0.0, 1.0, n // 14), 14)
    level, reading = np.empty(n), 1.0
    for t in range(n):
        k = max(t - 2, 0)
        reading += 0.4 * (1.0 / (0.95 + 0.1 * fuel[k] * (1.2 - 0.4 * air[k])) - reading)
        level[t] = reading + 0.001 * rng.standard_normal()
    return {"time_s": np.arange(n) / 10, "fuel": fuel, "air": air, OUTPUT: level}


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a model of three drives."""
    out = tmp_path_factory.mktemp("api") / "level.onnx"
    drives = [drive_of(1), pl.DataFrame(drive_of(2)), drive_of(3)]
    fitted = fit(drives, out, inputs=INPUTS, **QUICK)
    assert not any("one recording" in each for each in fitted.warnings)
    told = fitted.to_dict()
    assert told["inputs"] == list(INPUTS)
    assert told["fit"]["test"]["correlation"] > 0.9
    assert json.loads(json.dumps(told)) == told
    kind = "kind: narx, inputs: fuel air, correlation: 0"
    assert repr(fitted).startswith(f"<Fit file: {out}, {kind}")
    fitted.write_report(out.with_suffix(".html"))
    assert "fuel" in out.with_suffix(".html").read_text()
    return out


def test_a_model_of_arrays_is_evaluated_as_by_the_command(model: Path, tmp_path: Path) -> None:
    drive, path, out = drive_of(4), tmp_path / "drive.csv", tmp_path / "figures.json"
    names = (*INPUTS, OUTPUT)
    write_table(path, drive["time_s"], names, np.column_stack([drive[name] for name in names]))
    assert main(["evaluate", "--model", str(model), str(path), "--json", str(out)]) == 0
    told = json.loads(out.read_text())
    read = evaluate(model, path)
    assert repr(read) == f"<Evaluation {path}: RMSE {told['recordings'][0]['rmse']:.4g}>"
    assert read.to_dict() == told
    of_arrays = evaluate(model, drive).recordings[0]
    assert of_arrays["rmse"] == pytest.approx(told["recordings"][0]["rmse"], rel=1e-6)
    assert read.to_polars()["samples"].to_list() == [told["recordings"][0]["samples"]]


def test_a_drive_is_judged_with_the_new_model(model: Path) -> None:
    verdict = replay(drive_of(5), model=model, series=True)
    assert np.isfinite(verdict.columns()["predicted"]).mean() > 0.9
    assert not verdict.has_fault


def test_a_gap_is_looked_for_in_any_output(model: Path, tmp_path: Path) -> None:
    wrong = [drive_of(seed) for seed in (6, 7)]
    for each in wrong:
        each[OUTPUT] = each[OUTPUT] + 0.04 * each["fuel"]
    earlier = copy(model, tmp_path / "model.onnx")
    gap = find_gap(model, wrong, tmp_path, healthy=[*map(drive_of, (8, 9, 10))])
    assert gap.verdict != "no_gap"
    assert gap.model is None and not earlier.exists()
    assert repr(gap).startswith(f"<Gap verdict: {gap.verdict}, effects: ")
    gap.write_report(tmp_path / "gap.html")
    assert json.loads(json.dumps(gap.to_dict()))["verdict"] == gap.verdict


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda out: fit([drive_of(1)], out / "model.txt", inputs=INPUTS), "ends in .onnx"),
        (lambda out: fit([drive_of(1), drive_of(1)], out / "m.onnx", inputs=INPUTS), "the same as"),
        (lambda out: load_recordings({OUTPUT: [1.0]}), "recording 0: no column time_s"),
        (lambda out: load_recordings(out / "none.csv"), "none.csv"),
        (lambda _: load_recordings({"time_s": [1.0], OUTPUT: [1.0]}), "recording 0: too short"),
        (lambda _: load_recordings(drive_of(1), period_s=0.0), "a sample period of 0.0 s, above"),
        (lambda _: load_recordings(drive_of(1), period_s=np.nan), "a sample period of nan s"),
        (lambda out: estimate_tables(drive_of(1)), "lambda_measured|engine_speed_rpm"),
        (lambda out: fit([], out / "m.onnx"), "no recordings: one or more"),
        (lambda out: fit(drive_of(1), out / "m.onnx", kind="grey"), "kind 'grey': narx or grey"),
        (lambda out: fit(drive_of(1), out / "m.onnx", inputs=INPUTS, lags=0), "lags 0: 1 or more"),
        (lambda out: fit({}, out / "m.onnx", kind="greybox", lags=3), "lags: a grey-box model has"),
        (lambda _: evaluate(shipped_model(), []), "no recordings: one or more"),
        (lambda _: FitOptions(budget_minutes=np.inf), "budget inf: wanted are minutes"),
        (lambda _: FitOptions(wall_minutes=np.nan), "wall nan: wanted are minutes"),
        (lambda _: estimate_tables([]), "no recordings: one or more"),
        (lambda _: estimate_tables(drive_of(1), load="bar"), "load 'bar': kpa or mg"),
        (lambda _: GapOptions(add=["wings"]), "'wings' is unknown"),
    ],
)
def test_what_cannot_be_used_is_named(call: object, says: str, tmp_path: Path) -> None:
    assert callable(call)
    with pytest.raises(O2Error, match=says):
        call(tmp_path)


def test_recordings_and_tables_say_what_is_in_them() -> None:
    (recording,) = load_recordings(drive_of(1))
    told = "<Recording file: recording 0, samples: 2100 of 0.1 s, 3.5\xa0min, signals: fuel air"
    assert repr(recording) == f"{told} {OUTPUT}>"
    cells = np.array([[0.1, np.nan]])
    axes = Axis("speed", "", (1.0,)), Axis("load", "", (1.0, 2.0))
    bounds = {"low": cells, "high": cells, "samples": np.ones((1, 2), dtype=int)}
    table = EcuTable(name="delay", unit="s", axes=axes, estimate=cells, **bounds)
    told = "<EcuTable table: delay, axes: speed × load, cells: 1 of 2, range: 0.1 to 0.1 s>"
    assert repr(table) == told


def test_public_names_are_there() -> None:
    assert dir(training) == training.__all__
    for name in training.__all__:
        assert getattr(training, name).__doc__
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = training.nothing


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
        (training.evaluate, run_evaluate, {"washout"}),
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
