"""The study of the gap workflow: its plan, its cases, its answers and its command."""

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.studies.gap import main
from benchmarks.studies.targets import Target
from benchmarks.studies.workflow import case, drive, plan, tables
from benchmarks.studies.workflow.answers import (
    AMONG,
    answer,
    right,
    right_or_among,
    right_or_beside_fault,
    wrong_names,
)
from benchmarks.studies.workflow.plan import CASES, SEVERITIES, Study, cases, healthy_parts
from training.gap.inputs.roles import GapOptions
from training.greybox.effects import LIBRARY

WHOLE = Study()
TINY = [
    *("--cases", "effect=1", "null=1", "--vehicles", "1", "--drives", "2", "--minutes", "3"),
    *("--jobs", "1"),
]

COUNTS = ("drives", "before", "before_named", "after", "after_named")


def row(kind: str = "effect", **changed: Any) -> dict[str, Any]:
    """Return the row of a case in which purge, 3 times the noise, was named rightly."""
    return {
        "number": 0,
        "kind": kind,
        "vehicle": 2100,
        "hidden": ["purge"],
        "severities": [4.0],
        "fault": None,
        "fault_severity": None,
        "error": None,
        "verdict": "named",
        "names": ["purge"],
        "among": [],
        "indistinguishable": [],
        "noise": 0.007,
        "gap_over_noise": 3.0,
        "seconds": 4.0,
        "added": ["purge"],
        "faults": dict(zip(COUNTS, (20, 15, 12, 16, 11), strict=True)),
        "alarms": {"drives": 2, "before": 0, "after": 0},
        "excess_before": 1e-4,
        "excess_after": 5e-6,
    } | changed


def target(found: list[Target], where: str, what: str) -> Target:
    """Return the one target with these words."""
    (only,) = [t for t in found if where in t.where and what in t.what]
    return only


def test_the_whole_plan_is_large_enough_for_every_target() -> None:
    planned = cases(WHOLE)
    assert planned == cases(WHOLE)
    assert planned != cases(replace(WHOLE, seed=2_100_000))
    assert Counter(each.kind for each in planned) == Counter(CASES)
    effects = [each for each in planned if each.kind == "effect"]
    hidden = Counter(each.hidden[0] for each in effects)
    assert hidden == {(n, s): 3 for n, sizes in SEVERITIES.items() for s in sizes}
    assert set(SEVERITIES) == set(LIBRARY)
    assert len({each.vehicle for each in effects}) == WHOLE.vehicles
    assert len([each for each in planned if each.kind == "null"]) >= 400
    for name in LIBRARY:  # not always the same vehicle
        assert len({each.vehicle for each in effects if each.hidden[0][0] == name}) >= 5
    assert len({n for each in planned if each.kind == "unknown" for n, _ in each.hidden}) >= 3


def test_no_seed_is_used_twice() -> None:
    seeds = [part.seed for each in cases(WHOLE) for part in each.parts]
    vehicles = range(WHOLE.first_vehicle, WHOLE.first_vehicle + WHOLE.vehicles)
    seeds += [part.seed for vehicle in vehicles for part in healthy_parts(WHOLE, vehicle)]
    assert len(seeds) == len(set(seeds))


def test_a_fault_with_an_onset_begins_within_one_recording_and_stays() -> None:
    for each in (c for c in cases(WHOLE) if c.kind == "onset"):
        begins = [part.fault_start_s for part in each.parts]
        within = [
            b is not None and b > part.start_s for b, part in zip(begins, each.parts, strict=True)
        ]
        assert sum(within) == 1
        at = within.index(True)
        assert begins[:at] == [None] * at
        assert begins[at + 1 :] == [0.0] * (len(begins) - at - 1)


def test_hidden_effects_and_late_faults_are_in_the_recordings_and_nowhere_else() -> None:
    # GIVEN the soonest case with a fault that begins within the second of two recordings
    late = [c for c in cases(replace(WHOLE, drives=2, minutes=2.0)) if c.kind == "onset"]
    second = (c for c in late if c.parts[0].fault_start_s is None)
    onset = min(second, key=lambda c: sum(part.start_s for part in c.parts))
    # WHEN they are made with and without it
    with_it, without = (drive.recordings(onset, 120.0, hidden=h) for h in (True, False))
    # THEN the first is the same, and the second until the fault begins
    begins_s = onset.parts[1].fault_start_s
    assert begins_s is not None
    before = with_it[1].t_s < begins_s - onset.parts[1].start_s - 1.0
    assert np.array_equal(with_it[0].values, without[0].values, equal_nan=True)
    for name in ("lambda_measured", "fuel_mass_mg"):
        a, b = with_it[1].column(name), without[1].column(name)
        np.testing.assert_array_equal(a[before], b[before])
        assert not np.array_equal(a, b, equal_nan=True)
    assert with_it[1].sha256 != without[1].sha256
    assert abs(len(with_it[1].t_s) - 1200) < 5


def test_right_is_every_hidden_effect_named_and_nothing_else() -> None:
    assert right(row())
    assert not right(row(names=["ethanol"]))
    assert not right(row(names=["purge", "ethanol"]))
    assert not right(row(hidden=["purge", "ethanol"]))
    assert right(row(hidden=["purge", "ethanol"], names=["ethanol", "purge"]))
    assert not right(row(kind="null", hidden=[]))
    assert wrong_names(row(kind="null", hidden=[])) == ["purge"]
    assert right_or_among(row(verdict="ambiguous", names=[], among=["ethanol", "purge"]))
    assert not right_or_among(row(verdict="ambiguous", names=[], among=["ethanol", "mix_flow"]))


def test_an_effect_that_a_suspected_fault_looks_like_is_neither_named_nor_ambiguous() -> None:
    suspected = row(
        verdict="sensor_fault_suspected",
        names=[],
        hidden=["ethanol"],
        indistinguishable=["ethanol"],
    )
    assert not right(suspected)
    assert not right_or_among(suspected)
    assert right_or_beside_fault(suspected)
    assert not right_or_beside_fault(suspected | {"hidden": ["purge"]})


def test_targets_are_met_missed_or_unproved() -> None:
    # GIVEN 98 right names and 2 wrong ones on large gaps, and a null that was named
    rows = [row() for _ in range(98)] + [row(names=["ethanol"], excess_after=1e-4)] * 2
    rows += [row(kind="null", hidden=[], gap_over_noise=0.0)] + [
        row(kind="null", hidden=[], names=[], verdict="no_gap", gap_over_noise=0.0)
        for _ in range(49)
    ]
    rows.append(row(error="ValueError: no"))
    found = tables.assess(rows, "greybox")
    # THEN each target counts its own cases
    names = target(found, "everything", "all names")
    assert (names.trials, names.found, names.met) == (101, pytest.approx(98 / 101), False)
    big = target(found, "one effect, gap at least", "right name")
    assert (big.trials, big.found, big.met, big.proved) == (100, 0.98, True, True)
    null = target(found, "nothing hidden", "named")
    assert (null.found, null.met, null.verdict) == (0.02, False, "missed by 1.0 points")
    onset = target(found, "onset", "taken")
    assert (onset.trials, onset.met, onset.verdict) == (0, None, "not judged: no such drive")
    over_all = target(found, "all of one effect", "median")
    assert (over_all.trials, over_all.found) == (100, pytest.approx(0.95))
    assert target(found, "all", "seconds").met
    faults = target(found, "new models", "put on and found")
    assert (faults.least, faults.found, faults.trials, faults.met) == (0.75, 0.8, 98 * 20, True)
    named = target(found, "new models", "named right")
    assert (named.least, named.found, named.met) == (0.6, 0.55, False)
    assert target(found, "new models", "false alarms").met


def test_the_confusion_matrix_counts_every_case_once() -> None:
    rows = [
        row(),
        row(names=["ethanol"]),
        row(kind="null", hidden=[], names=[], verdict="no_gap"),
        row(kind="onset", hidden=[], names=[], verdict="sensor_fault_suspected", fault="gain_low"),
        row(kind="two", hidden=["purge", "ethanol"], names=["purge", "ethanol"]),
        row(error="ValueError: no"),
    ]
    found = {
        (r["driven"], r["answered"]): r["trials"]
        for r in tables.report(WHOLE, rows).sections[0].rows
    }
    assert sum(found.values()) == len(rows)
    assert all(found["purge", name] == 1 for name in ("purge", "ethanol", "error"))
    assert found["two effects", "purge + ethanol"] == 1
    assert found["onset: gain_low", "sensor_fault_suspected"] == 1
    assert tables.two(rows) == [{"answer": "both right", "cases": 1}]
    assert answer(row(verdict="ambiguous", names=[], among=["purge"])) == AMONG
    assert answer(row(verdict="ambiguous", names=[], among=["ethanol"])) == "ambiguous"


def test_an_error_in_a_case_is_a_row_and_not_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise RuntimeError("no convergence")

    monkeypatch.setattr(case, "investigate", fails)
    study = replace(WHOLE, drives=2, minutes=2.0)
    vehicle = case.Vehicle(2100, Path(), (), None, 0.007)  # type: ignore[arg-type]
    found = case.run(cases(study)[0], study, vehicle)
    assert found["error"] == "RuntimeError: no convergence"
    made = tables.report(study, [found])
    assert "1 of them ended in an error" in made.as_text()
    assert [r["error"] for r in made.sections[-1].rows] == ["RuntimeError: no convergence"]


def test_a_small_study_is_run_and_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan, "HEALTHY_DRIVES", 4)
    assert main([*TINY, "--out", str(tmp_path)]) == 0
    assert "2 of 2 simulated cases reached" in capsys.readouterr().out
    paths = sorted((tmp_path / "rows").glob("case*"))
    rows = [json.loads(path.read_text())["rows"][0] for path in paths]
    assert [r["kind"] for r in rows] == ["effect", "null"]
    assert all(r["error"] is None and r["seconds"] > 0.0 for r in rows)
    assert rows[1]["gap"] == 0.0
    assert rows[1]["excess_before"] == pytest.approx(0.0, abs=1e-12)
    assert json.loads((tmp_path / "gap.json").read_text())["source"] == "simulated"
    page = (tmp_path / "report.html").read_text()
    assert ">Hidden and answered</h2>" in page
    assert rows[0]["hidden"][0].replace("_", " ") in page


def test_a_sensor_declared_good_is_declared_to_the_workflow_and_has_no_faults(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # GIVEN a study in which the sensor is declared good, and one in which it is not
    small = replace(WHOLE, cases=(("effect", 1),), drives=2, minutes=2.0)
    told: list[bool] = []

    def takes_note(_: object, __: object, options: GapOptions, **___: object) -> None:
        told.append(options.sensor_known_good)
        raise RuntimeError("enough")

    monkeypatch.setattr(case, "investigate", takes_note)
    vehicle = case.Vehicle(2100, Path(), (), None, 0.007)  # type: ignore[arg-type]
    # WHEN a case of either is run
    for study in (replace(small, sensor_known_good=True), small):
        assert case.run(cases(study)[0], study, vehicle)["error"] == "RuntimeError: enough"
    # THEN the workflow is told so in the first
    assert told == [True, False]
    # and cases with a faulty sensor are left out, or refused
    good = ["--sensor-known-good", "--out", str(tmp_path)]
    assert {each.kind for each in cases(Study(sensor_known_good=True))}.isdisjoint(plan.FAULTY)
    assert main([*good, "--cases", "fault=1"]) == 2
    assert "kind 'fault': its sensors are not known to be good" in capsys.readouterr().err
