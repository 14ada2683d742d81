"""Tables without the model's signals: the catalyst is judged alone."""

import json
from pathlib import Path
from typing import Any

import pytest

from monitor import cli
from tests.conftest import ROOT
from tests.helpers.drives.switching_drive import switching_drive
from tests.helpers.logs.replays import replay_log, replays


def replayed(table: Path, tmp_path: Path, *options: str) -> tuple[int, dict[str, Any]]:
    page = tmp_path / "out.html"
    code, (recording,) = replays(table, "--html", page, *options)
    assert page.stat().st_size > 1000
    return code, recording


def a_table(folder: Path, *, stores: bool, names: str = "", period_s: float = 0.2) -> Path:
    path = folder / "drive.csv"
    rows = zip(*switching_drive(stores=stores, period_s=period_s), strict=True)
    lines = ["time_s,upstream_voltage_v,downstream_voltage_v,engine_speed_rpm"]
    lines += [f"{t_s:.3f},{front:.3f},{rear:.3f},2000" for t_s, front, rear in rows]
    text = "\n".join(lines).replace("upstream_voltage_v,d", f"{names or 'upstream_voltage_v'},d", 1)
    path.write_text(text + "\n")
    return path


def test_a_can_that_stores_nothing_is_found_without_a_wideband_sensor(tmp_path: Path) -> None:
    code, recording = replayed(a_table(tmp_path, stores=False), tmp_path)
    assert code == 1
    assert [(d["code"], d["fault"]) for d in recording["dtcs"]] == [("P0420", "catalyst_low")]
    assert recording["catalyst"]["method"] == "activity"
    assert "Behind the catalyst" in (tmp_path / "out.html").read_text()


def test_a_warm_up_catalyst_close_to_the_engine_has_a_code_of_its_own(tmp_path: Path) -> None:
    settings = tmp_path / "settings.toml"
    settings.write_text('[catalyst]\nposition = "close_coupled"\n')
    table = a_table(tmp_path, stores=False)
    _, recording = replayed(table, tmp_path, "--config", str(settings))
    assert [(d["code"], d["fault"]) for d in recording["dtcs"]] == [("P0421", "catalyst_low")]


def test_a_signal_map_says_where_the_catalyst_stands(tmp_path: Path) -> None:
    log, own = replay_log("catalyst_low"), tmp_path / "own.toml"
    text = (ROOT / "dbc" / "o2_ecu.toml").read_text()
    own.write_text(f'{text}\n[catalyst]\nposition = "close_coupled"\n')
    bus = ("--dbc", str(ROOT / "dbc" / "o2_ecu.dbc"), "--map", str(own))
    _, recording = replayed(log, tmp_path, *bus)
    assert [(d["code"], d["fault"]) for d in recording["dtcs"]] == [("P0421", "catalyst_low")]
    own.write_text(f'{text}\n[catalyst]\nposition = "roof"\n')
    assert cli.main(["replay", str(log), *bus]) == 2


def test_a_catalyst_that_stores_is_sound_and_nothing_else_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, recording = replayed(a_table(tmp_path, stores=True), tmp_path)
    assert (code, recording["dtcs"], recording["not_judged"]) == (0, [], None)
    assert any("only the catalyst" in note for note in recording["notes"])
    said = "catalyst passed, nothing else was judged."
    assert (tmp_path / "out.html").read_text().lower().count(said) == 2  # verdict and confidence
    # AND a sink that gets nothing of it is told of
    lines = f"jsonl:{tmp_path / 'out.jsonl'}"
    assert cli.main(["replay", str(tmp_path / "drive.csv"), "--sink", lines]) == 0
    assert "without a model, so the sinks get nothing of it" in capsys.readouterr().err
    # WHEN its memory is new because the one before was damaged THEN no more was judged
    memory = tmp_path / "o2.db"
    memory.write_bytes(b"o2mon torn")
    _, recording = replayed(tmp_path / "drive.csv", tmp_path, "--memory", str(memory))
    assert [dtc["code"] for dtc in recording["dtcs"]] == ["P062F"]
    assert (tmp_path / "out.html").read_text().lower().count(said) == 2


@pytest.mark.parametrize(
    ("volts", "codes", "exit_code"), [(0.01, ["P0137"], 1), (1.4, ["P0138"], 1), (0.06, [], 3)]
)
def test_a_rear_sensor_that_is_shorted_or_on_one_side_passes_no_catalyst(
    volts: float, codes: list[str], exit_code: int, tmp_path: Path
) -> None:
    # GIVEN a rear voltage that stays where it is while the front sensor switches
    table = a_table(tmp_path, stores=True)
    head, *rows = table.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    table.write_text("\n".join([head, *(f"{t},{front},{volts},2000" for t, front, *_ in cells)]))
    # THEN its circuit fails by a voltage at an end, and nothing is passed
    code, recording = replayed(table, tmp_path)
    assert (code, [d["code"] for d in recording["dtcs"]]) == (exit_code, codes)
    assert recording["catalyst"]["verdict"] == "inconclusive"
    if not codes:
        (cause,) = recording["not_judged"]
        assert "on one side only" in cause["advice"]


def test_the_capacity_stands_among_the_results_of_the_tests(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, memory = replay_log("catalyst_low"), str(tmp_path / "memory.db")
    assert (
        cli.main(["replay", str(log), "--html", str(tmp_path / "page.html"), "--memory", memory])
        == 1
    )
    capsys.readouterr()
    assert cli.main(["dtc", "readiness", "--memory", memory, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    page = (tmp_path / "page.html").read_text()
    assert "Behind the catalyst" in page
    assert "threshold 0.12" in page
    results = {(r["test"], r["quantity"]): r for r in found["results"]}
    capacity = results["catalyst", "capacity_g"]
    assert capacity["value"] < capacity["low"] == 0.12
    assert ("downstream", "lag_rich_to_lean_s") in results
    assert results["downstream_heater", "wake_s"]["value"] < 25.0
    tests = {t["test"]: t["completed_since_clear"] for t in found["tests"]}
    assert tests["catalyst"]
    assert tests["balance"]
    # and the freeze frame holds the capacity at which the code was set
    assert cli.main(["dtc", "freeze-frame", "--memory", memory]) == 0
    assert "catalyst_capacity_g" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("names", "period_s", "reason"),
    [("throttle_percent", 0.2, "signal_missing"), ("", 1.0, "too_slow")],
)
def test_what_cannot_be_judged_says_why(
    names: str, period_s: float, reason: str, tmp_path: Path
) -> None:
    code, recording = replayed(
        a_table(tmp_path, stores=False, names=names, period_s=period_s), tmp_path
    )
    assert code == 3
    assert [cause["reason"] for cause in recording["not_judged"]] == [reason]


@pytest.mark.parametrize(("drive", "code"), [("after", 1), ("before", 0)])
def test_a_real_car_without_its_catalyst_is_found_and_with_it_is_sound(
    drive: str, code: int, shared_data: Path, tmp_path: Path
) -> None:
    (log,) = (shared_data / "logs" / "evo_evoscan").glob(f"{drive}_*.csv")
    got, recording = replayed(log, tmp_path)
    assert got == code
    assert [d["code"] for d in recording["dtcs"]] == ["P0420"] * code


def test_a_real_log_of_one_sample_a_second_says_what_is_missing(
    shared_data: Path, tmp_path: Path
) -> None:
    code, recording = replayed(shared_data / "logs" / "golf_torque" / "golf07_2.csv", tmp_path)
    assert code == 3
    reasons = {cause["condition"]: cause for cause in recording["not_judged"]}
    assert reasons["catalyst"]["signal"] == "maf_kg_h"
    assert reasons["response"]["reason"] == "no_model"
