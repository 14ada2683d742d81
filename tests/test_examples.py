"""The examples run as they are; `make examples` runs the long ones, too."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from monitor import load_model
from tests.conftest import ROOT
from tests.helpers.logs.injected_frames import first_minutes
from tests.vcan.guest import WITHOUT_MDF
from training.fleet.page import fleet_page

EXAMPLES = ROOT / "examples"
QUICK = {
    "first_verdict.py": ("no fault", "FAULT: P0133 slow_symmetric"),
    "listen_on_a_bus.py": ("P015A delay_symmetric is pending", "bus: FAULT: P015A"),
}


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def ran_quickly(call: list[str]) -> "subprocess.CompletedProcess[str]":
    """Run a program whose imports of python-can leave out what reads .mf4."""
    path = os.pathsep.join((str(WITHOUT_MDF), os.environ.get("PYTHONPATH", "")))
    own = os.environ | {"PYTHONPATH": path}
    return subprocess.run(call, capture_output=True, text=True, check=True, cwd=ROOT, env=own)


@pytest.mark.parametrize("name", QUICK)
def test_an_example_runs_as_it_is(name: str) -> None:
    call = [sys.executable, str(EXAMPLES / name)]
    ran = ran_quickly(call)
    for words in QUICK[name]:
        assert words in ran.stdout


@pytest.mark.waits
def test_a_drive_on_a_virtual_bus_sets_the_flag_that_is_read_back_from_the_bus(
    tmp_path: Path,
) -> None:
    # GIVEN a stretch of a drive whose sensor is late from its fifth second on, its code at the 20th
    drive = first_minutes(tmp_path, 36.0, from_s=30.0)
    call = [sys.executable, str(EXAMPLES / "virtual_bus.py"), "--live", "", "--seconds", "36"]
    # WHEN it is played in real time into a bus of this machine
    call += ["--drive", str(drive), "--fault", "delay_rich_to_lean=0.8@5"]
    ran = ran_quickly(call)
    # THEN the bus carried the monitor's states in their order, the flag and the code
    told = ran.stdout
    states = [told.index(each) for each in ("not enabled, no flag", "monitoring, no flag")]
    assert states == sorted(states)
    assert "fault flag set, code P015A" in told
    assert "verdict    P015A delay_rich_to_lean (pending)" in told


def test_a_query_finds_a_late_sensor_in_the_results_of_a_fleet(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet = example("fleet_in_dask")
    monkeypatch.setattr(fleet, "FLEET", {"taxi_18": ("delay_rich_to_lean",) * 2})
    figures = {"completed": {"events": 2}, "not_judged": []}
    monkeypatch.setattr(fleet_page, "write", lambda *_: ("", "", figures))  # drawn in its own tests
    fleet.main(None)
    said = capsys.readouterr().out
    assert "taxi_18 2026-03-02: P015A delay_rich_to_lean, pending" in said
    assert "taxi_18 2026-03-03: P015A delay_rich_to_lean, confirmed" in said
    assert re.search(r"taxi_18: \d\d windows, mean [+-]0\.0\d+", said)


def test_a_reader_of_twenty_lines_predicts_as_the_monitor_does() -> None:
    model = load_model()
    rng = np.random.default_rng(5)
    inputs = model.card.inputs
    columns = {
        each.name: rng.uniform(each.minimum, each.maximum, 200).astype(np.float32)
        for each in inputs
    }
    u = np.column_stack([columns[each.name] for each in inputs])
    model.reset(u[0])
    predicted = example("read_model").predict(str(model.path), columns)
    np.testing.assert_array_equal(predicted, [model.step(row) for row in u])


def test_the_reader_has_twenty_lines() -> None:
    source = (EXAMPLES / "read_model.py").read_text().split("if __name__")[0]
    body = source[source.index("import json") :]
    assert len([line for line in body.splitlines() if line.strip()]) <= 20
