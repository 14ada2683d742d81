"""The detection matrix: its plan, its drives, its tables and its command."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.studies.matrix import main
from benchmarks.studies.sensor import run, tables
from benchmarks.studies.sensor.conditions import AMBIENTS, weather
from benchmarks.studies.sensor.drive import samples
from benchmarks.studies.sensor.plan import (
    Matrix,
    calibration,
    reference_drives,
    refuse_used,
    trials,
)
from benchmarks.studies.sensor.severities import (
    ELECTRICAL,
    LIMIT_SEVERITY,
    SEVERITIES,
    beyond_limit,
)
from benchmarks.studies.tables import Row
from benchmarks.studies.targets import Target
from monitor.base.errors import UsageError
from training.dyno import ecu

FIRST, SEED = 2000, 2_100_000
DEVELOPMENT = Matrix(first_vehicle=FIRST, seed=SEED)
SMALL = replace(
    DEVELOPMENT,
    vehicles=2,
    repetitions=2,
    healthy=2,
    reference_drives=1,
    cycles=("us06",),
    ambients=("mild",),
    faults=(("biased_lean", (0.05,)),),
)


def test_the_whole_plan_is_large_enough_for_every_target() -> None:
    planned = trials(DEVELOPMENT)
    assert planned == trials(DEVELOPMENT)
    healthy = [t for t in planned if t.kind == "healthy"]
    assert len(planned) >= 5000
    assert len(healthy) >= tables.HEALTHY_DRIVES
    assert len({t.vehicle for t in healthy}) >= tables.HEALTHY_VEHICLES
    assert {t.ambient for t in healthy} == set(AMBIENTS)
    for name, limit in LIMIT_SEVERITY.items():
        for placement in ("loop", "after"):
            own = [t for t in planned if (t.fault, t.placement) == (name, placement)]
            at = [t for t in own if t.severity == limit]
            assert len(at) >= 100
            assert len({t.vehicle for t in at}) == DEVELOPMENT.vehicles
            assert {t.ambient for t in at} == set(AMBIENTS)
            for severity in SEVERITIES[name]:
                assert sum(t.severity == severity for t in own) >= 20
    for name in ELECTRICAL:
        assert sum(t.fault == name for t in planned) >= 20
    every = [*planned, *(t for own in reference_drives(DEVELOPMENT) for t in own)]
    assert len({t.seed for t in every}) == len(every)
    assert all(0.0 <= t.ethanol <= 0.10 for t in every)


def test_each_kind_of_weather_is_what_its_name_says() -> None:
    drawn = {name: [weather(name, seed) for seed in range(200)] for name in AMBIENTS}
    assert all(35.0 <= c.ambient_degc <= 43.0 for c in drawn["hot"])
    assert all(c.coolant_start_degc == c.ambient_degc <= -5.0 for c in drawn["cold"])
    assert all(72.0 <= c.ambient_kpa <= 80.0 for c in drawn["altitude"])
    assert len({c.ambient_degc for c in drawn["mild"]}) == 200


def test_vehicles_and_seeds_that_have_served_before_are_refused() -> None:
    trained = ["wltc_3b_v1_s1001_healthy.parquet", "drive.log", "udds_v2003_s7_healthy.log"]
    refuse_used(trials(DEVELOPMENT), trained[:2])
    with pytest.raises(UsageError, match="vehicle 2003 has trained"):
        refuse_used(trials(DEVELOPMENT), trained)
    with pytest.raises(UsageError, match="seed 1001 has trained"):
        refuse_used(trials(replace(DEVELOPMENT, seed=1000)), trained[:2])
    with pytest.raises(UsageError, match=r"vehicle 3000, seed .* are set on"):
        refuse_used(trials(replace(DEVELOPMENT, first_vehicle=2990)), [])
    with pytest.raises(UsageError, match=r"seed 3000020: .* are set on"):
        refuse_used(trials(replace(DEVELOPMENT, seed=3_000_020)), [])


def test_the_literatures_rules_are_set_on_every_fault_that_must_be_found() -> None:
    good, bad = calibration(DEVELOPMENT)
    assert {(t.fault, t.severity) for t in bad} == set(LIMIT_SEVERITY.items())
    assert {t.placement for t in bad} == {"loop", "after"}
    assert 2 * sum(t.aged is not None for t in good) == len(good)
    own = {t.seed for t in trials(DEVELOPMENT)} | {t.vehicle for t in trials(DEVELOPMENT)}
    assert not own & {n for t in (*good, *bad) for n in (t.seed, t.vehicle)}


def test_what_must_be_found_begins_at_the_limit_severity() -> None:
    assert beyond_limit("delay_symmetric", 0.4)
    assert not beyond_limit("delay_symmetric", 0.39)
    assert not beyond_limit("gain_low", 0.61)
    assert not beyond_limit("stuck_lean", 0.15)


def test_only_a_fault_in_the_loop_moves_the_controller() -> None:
    bus_map = ecu.own_bus()
    trial = next(t for t in trials(SMALL) if t.placement == "after")
    driven = {
        "after": trial,
        "loop": replace(trial, placement="loop"),
        "healthy": replace(trial, kind="healthy", fault="", severity=None, placement=""),
    }
    trim, reading = {}, {}
    for key, each in driven.items():
        values = samples(each, bus_map, 100_000_000).values
        trim[key] = np.nanmean(values[1000:, bus_map.names.index("lambda_controller")])
        reading[key] = np.nanmedian(values[1000:, bus_map.names.index("lambda_measured")])
    assert trim["after"] == trim["healthy"]
    assert trim["loop"] > trim["healthy"] + 0.02
    assert reading["after"] == pytest.approx(reading["healthy"] + 0.05, abs=0.002)


def small(folder: Path) -> list[str]:
    words = "--vehicles 2 --healthy 2 --repetitions 1 --reference-drives 1 --jobs 1"
    words += f" --first-vehicle {FIRST} --seed {SEED} --cycles us06 --ambients mild --faults"
    return [*words.split(), "delay_symmetric=0.4,2", "signal_missing", "--out", str(folder)]


def test_the_command_drives_a_small_matrix_and_reports_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # GIVEN few drives for the literature's rules
    good, bad = calibration(SMALL)
    few = [replace(t, cycle="hwfet", ambient="hot") for t in good[:3]]
    monkeypatch.setattr(run, "calibration", lambda _: (few, bad[:1]))
    monkeypatch.setattr("benchmarks.studies.rules.alarms.FALSE_ALARM_RATE", 0.05)
    # WHEN the matrix is driven
    assert main(small(tmp_path)) == 0
    # THEN both faults are found, and text, JSON and page say so
    assert "9 simulated drives" in capsys.readouterr().out
    result = json.loads((tmp_path / "matrix.json").read_text())
    cells = {
        (d["severity"], d["placement"]): d["named"]["events"]
        for d in result["tables"]["Detection against severity"]
    }
    assert cells[2.0, "loop"] == cells[2.0, "after"] == cells[1.0, "loop"] == 1
    rules = [r["rule"] for r in result["tables"]["Rules of the literature"]]
    assert rules == ["monitor", *tables.TITLES.values()]
    html = (tmp_path / "report.html").read_text()
    assert "no figure is final" in html  # of vehicles for development
    assert html.count('<figure class="plots">') == 1
    assert html.count('<table class="heat">') == 2
    # WHEN it is asked for again THEN nothing is driven anew
    monkeypatch.setattr(run, "samples", None)
    assert main(small(tmp_path)) == 0


def row(number: int, fault: str = "", severity: float | None = None, **changes: Any) -> Row:
    """Return a row of a WLTC; a fault is found and named unless the changes say otherwise."""
    names = (*tables.TITLES, "monitor")
    return {
        "number": number,
        "kind": "faulty" if fault else "healthy",
        "vehicle": FIRST + number % 2,
        "cycle": "wltc_3b",
        "ambient": "mild",
        "fault": fault,
        "severity": severity,
        "placement": "loop" if fault else "",
        "seed": SEED + number,
        "aged": None,
        "completed": True,
        "codes": ["P0133"] if fault else [],
        "faults": [fault] if fault else [],
        "also": [],
        "first_code_driving_s": 100.0 if fault else None,
        "first_code_enabled_s": 30.0 if fault else None,
        "driving_s": 1800.0,
        "enabled_s": 900.0,
        "windows": 100,
        "not_held": dict.fromkeys(tables.CONDITIONS, 0.1),
        "alarms_enabled_s": dict.fromkeys(names, 40.0 if fault else None),
        "failed_windows": dict.fromkeys(names, 50 if fault else 1),
    } | changes


@pytest.fixture
def hand_made() -> list[Row]:
    """60 healthy drives, one with a false code; 40 slow ones, two missed, two misnamed."""
    missed: dict[str, Any] = {"codes": [], "faults": [], "first_code_enabled_s": None}
    both = ["delay_symmetric", "slow_symmetric"]
    changes = {100: missed, 101: missed, 102: {"faults": ["transient"]}, 104: {"faults": both}}
    slow = [row(i, "slow_symmetric", 0.5, **changes.get(i, {})) for i in range(100, 140)]
    slow[3] = row(103, "slow_symmetric", 0.2, **missed)
    false = {"codes": ["P0133"], "faults": ["slow_symmetric"], "first_code_driving_s": 9.0}
    healthy = {7: false, 9: {"completed": False}}
    return [*(row(i, **healthy.get(i, {})) for i in range(60)), *slow]


def target(rows: list[Row], what: str, where: str) -> Target:
    return next(t for t in tables.assess(rows) if what in t.what and where in t.where)


def test_targets_stand_beside_what_was_found(hand_made: list[Row]) -> None:
    detected = target(hand_made, "detected", "in the loop, at the limit")
    assert (detected.found, detected.trials) == (37 / 39, 39)
    assert detected.verdict == "missed by 4.1 points"
    assert target(hand_made, "named", "in the loop, at the limit").found == 35 / 39
    assert target(hand_made, "median", "in the loop, at the limit").met
    assert target(hand_made, "detected", "afterwards, at the limit").met is None
    assert target(hand_made, "pending", "healthy").verdict == "missed by 1"
    assert target(hand_made, "confirmed", "healthy").met is None  # too few drives to say
    completed = target(hand_made, "completed", "healthy")
    assert (completed.found, completed.met, completed.proved) == (59 / 60, True, False)


def test_zero_false_codes_are_a_target_met_only_by_many_drives_of_many_vehicles() -> None:
    many = [row(i, vehicle=FIRST + i % 50) for i in range(500)]
    assert target(many, "pending", "healthy").met is True
    assert target(many[:-1], "pending", "healthy").met is None


def test_a_code_of_two_drives_in_a_row_of_a_vehicle_would_be_confirmed() -> None:
    coded = {"codes": ["P0133"]}
    drives = [row(0, **coded, vehicle=1), row(1, vehicle=1), row(2, **coded, vehicle=1)]
    assert tables.confirmed(drives) == 0  # drive 1 has passed
    skipped = row(1, vehicle=1, completed=False)
    assert tables.confirmed([drives[0], skipped, drives[2]]) == 1
    assert tables.confirmed([drives[0], skipped, row(2, **coded, vehicle=2)]) == 0


def test_tables_of_hand_made_rows(hand_made: list[Row]) -> None:
    cells = {d["severity"]: d for d in tables.detection(hand_made)}
    assert (cells[0.5]["detected"]["events"], cells[0.2]["detected"]["events"]) == (37, 0)
    given = {(r["driven"], r["answered"]): r["trials"] for r in tables.names(hand_made, "loop")}
    assert given["slow_symmetric", "slow_symmetric"] == 35
    assert given["slow_symmetric", "delay_symmetric + slow_symmetric"] == 1
    assert (given["slow_symmetric", "none"], given["healthy", "none"]) == (2, 59)
    monitor, card, *_ = tables.side_by_side(hand_made)
    assert monitor["loop, found"]["rate"] == 37 / 39
    assert card["loop, found"]["rate"] == 1.0
    assert card["false windows"]["rate"] == 0.01
    assert tables.healthy(hand_made)[0]["per 1000 h"]["per_1000_h"] == pytest.approx(1000 / 30)


def test_a_part_of_the_rows_makes_a_report_too(hand_made: list[Row]) -> None:
    for part in ([], hand_made[:1], hand_made[-1:]):
        page = tables.report(SMALL, "shipped.onnx", part).as_page({"code_sha256": "0" * 64})
        assert f"{len(part)} simulated drives" in page
