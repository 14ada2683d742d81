"""The recordings of replay_logs, replayed with all defaults and compared with what is expected."""

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from monitor import cli
from monitor.base.files import manifest
from tests.conftest import ROOT
from tests.helpers.logs.replays import replays

LOGS = manifest.load(ROOT / "replay_logs")
NAMES = sorted(LOGS)
CIRCUIT = {f"downstream_{kind}" for kind in ("low", "high", "inactive", "heater")}
TOLERANCE = 1e-5  # lambda; another processor sums in another order


@pytest.fixture(autouse=True)
def _at_the_root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)


def test_there_is_a_drive_for_health_and_for_every_fault() -> None:
    from monitor.base import faults
    from training.dyno.downstream import FAULTS

    found = {entry["fault"] for entry in LOGS.values()}
    assert found - set(FAULTS) == {None, *faults.NAMES}
    assert {"catalyst_low", *CIRCUIT} <= found
    assert sum((ROOT / "replay_logs" / name).stat().st_size for name in NAMES) < 30e6
    assert all(entry["source"] == "simulated" for entry in LOGS.values())


def test_no_drive_is_of_a_vehicle_or_seed_that_training_saw() -> None:
    assert all(entry["vehicle"] != 1 and entry["seed"] < 1001 for entry in LOGS.values())


@pytest.mark.parametrize("name", NAMES)
def test_a_recorded_drive_is_judged_as_expected(name: str) -> None:
    entry, log = LOGS[name], Path("replay_logs") / name
    assert hashlib.sha256(log.read_bytes()).hexdigest() == entry["sha256"]
    code, (recording,) = replays(log)
    assert code == entry["expected"]["exit_code"]
    assert {d["fault"] for d in recording["dtcs"]} == ({entry["fault"]} - {None})
    (golden,) = json.loads((ROOT / f"replay_logs/expected/{name}.json").read_text())["recordings"]
    behind, expected_behind = recording.pop("catalyst", {}), golden.pop("catalyst", {})
    for key, value in expected_behind.items():
        near = isinstance(value, float)
        assert behind[key] == (pytest.approx(value, rel=1e-3, abs=1e-3) if near else value), key
    assert behind.keys() == expected_behind.keys()
    assert without_numbers(recording) == without_numbers(golden)
    for window, expected in zip(recording["windows"], golden["windows"], strict=True):
        for key in ("mean", "std"):
            assert window[key] == pytest.approx(expected[key], abs=TOLERANCE)


def without_numbers(recording: dict[str, Any]) -> dict[str, Any]:
    """Return what must agree to the letter: everything but the windows' statistics."""
    kept = ("index", "t_start_s", "t_end_s", "paper_failed", "verdict", "fault", "also")
    windows = [{key: window[key] for key in kept} for window in recording["windows"]]
    return recording | {"windows": windows}


def test_the_same_log_gives_the_same_bytes_and_the_page_too(tmp_path: Path) -> None:
    log = f"replay_logs/{next(n for n in NAMES if n.startswith('transient'))}"
    for run in ("a", "b"):
        json_out, html_out = tmp_path / f"{run}.json", tmp_path / f"{run}.html"
        cli.main(["replay", log, "--json", str(json_out), "--html", str(html_out)])
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_each_log_is_a_driving_cycle_of_its_own_without_memory() -> None:
    faulty = f"replay_logs/{next(n for n in NAMES if n.startswith('stuck_lean'))}"
    healthy = f"replay_logs/{next(n for n in NAMES if n.startswith('healthy_micro'))}"
    code, recordings = replays(faulty, healthy)
    assert (code, [r["fault_flag"] for r in recordings]) == (1, [True, False])
