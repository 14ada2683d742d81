"""The matrix: its plan, its faults put on afterwards, its run and its command."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.studies.matrix import main
from benchmarks.studies.sensor import run
from benchmarks.studies.sensor.conditions import AMBIENTS, weather
from benchmarks.studies.sensor.drive import put_on, samples
from benchmarks.studies.sensor.goals import LIMIT_SEVERITY
from benchmarks.studies.sensor.plan import (
    Matrix,
    calibration,
    reference_drives,
    refuse_used,
    trials,
)
from benchmarks.studies.sensor.severities import ELECTRICAL, NOT_AFTERWARDS, SEVERITIES
from monitor.base import config, faults
from monitor.base.errors import RecordingError, UsageError
from monitor.base.fault_streams import SensorFault
from monitor.pipeline.replay import shipped_model
from tests.helpers.matrices import FIRST, SEED, SMALL
from training.dyno import ecu
from training.dyno.simulation import Experiment, simulate

DEVELOPMENT = Matrix(first_vehicle=FIRST, seed=SEED)


def test_a_matrix_is_planned_alike_every_time_and_by_its_seed() -> None:
    assert trials(DEVELOPMENT) == trials(DEVELOPMENT)
    assert reference_drives(DEVELOPMENT) == reference_drives(DEVELOPMENT)
    other = trials(replace(DEVELOPMENT, seed=SEED + 100_000))
    assert not any(
        a.conditions == b.conditions for a, b in zip(trials(DEVELOPMENT), other, strict=True)
    )


def test_the_whole_plan_is_large_enough_for_every_target() -> None:
    planned = trials(DEVELOPMENT)
    healthy = [t for t in planned if t.kind == "healthy"]
    assert len(planned) >= 5000
    assert len(healthy) >= 500
    assert len({t.vehicle for t in healthy}) >= 50
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
    assert all(-15.0 <= c.ambient_degc <= -5.0 for c in drawn["cold"])
    assert all(c.coolant_start_degc == c.ambient_degc for c in drawn["cold"])
    assert all(72.0 <= c.ambient_kpa <= 80.0 for c in drawn["altitude"])
    assert len({c.ambient_degc for c in drawn["mild"]}) == 200
    with pytest.raises(UsageError, match="tropical"):
        weather("tropical", 1)


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


@pytest.mark.parametrize("name", [n for n in faults.NAMES if n not in NOT_AFTERWARDS])
def test_a_fault_put_on_a_whole_drive_is_the_streaming_one_sample_by_sample(name: str) -> None:
    drive = simulate(Experiment(cycle="us06", vehicle=FIRST, seed=SEED, duration_s=120.0))
    healthy, fault = drive["lambda_measured"], faults.resolve(name)
    put = put_on(healthy, fault)
    streamed = np.array(SensorFault(fault, 0.01).apply(healthy.tolist()))
    assert np.isnan(healthy).any()
    np.testing.assert_allclose(put, np.minimum(streamed, 15.9), rtol=1e-12)
    assert np.nanmax(np.abs(put - healthy)) > 0.005


def test_a_fault_of_the_communication_cannot_be_put_on_readings() -> None:
    with pytest.raises(UsageError, match="not_ready"):
        put_on(np.ones(10), faults.resolve("not_ready"))


def test_only_a_fault_in_the_loop_moves_the_controller() -> None:
    bus_map = ecu.own_bus()
    planned = trials(replace(SMALL, faults=(("biased_lean", (0.05,)),)))
    trial = next(t for t in planned if t.placement == "after")
    healthy = replace(trial, kind="healthy", fault="", severity=None, placement="")
    seen = {}
    for key, each in (
        ("after", trial),
        ("loop", replace(trial, placement="loop")),
        ("healthy", healthy),
    ):
        block = samples(each, bus_map, 100_000_000)
        trim, reading = (
            block.values[:, bus_map.names.index(n)]
            for n in ("lambda_controller", "lambda_measured")
        )
        seen[key] = np.nanmean(trim[1000:]), np.nanmedian(reading[1000:])
    assert seen["after"][0] == seen["healthy"][0]
    assert seen["loop"][0] > seen["healthy"][0] + 0.02
    assert seen["after"][1] == pytest.approx(seen["healthy"][1] + 0.05, abs=0.002)


class StoppedError(Exception):
    """The run was ended."""


def test_a_run_that_was_stopped_goes_on_and_gives_the_same_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "CHUNK", 3)
    monkeypatch.setattr(run, "_rules", lambda *_: {})
    driven: list[int] = []
    whole = samples

    def counted(trial: Any, *others: Any) -> Any:
        driven.append(trial.seed)
        return whole(trial, *others)

    monkeypatch.setattr(run, "samples", counted)
    settings = config.load()

    def do(folder: str, done: Any = lambda _: None, matrix: Matrix = SMALL) -> Any:
        return run.run(matrix, shipped_model(), settings, tmp_path / folder, done)

    def stop(_: int) -> None:
        raise StoppedError

    rows = do("whole")
    assert len(rows) == len(driven) == run.count(SMALL) == 8
    driven.clear()
    with pytest.raises(StoppedError):
        do("stopped", stop)
    assert 0 < len(driven) < 8
    assert do("stopped") == rows
    assert len(driven) == 8  # nothing twice
    with pytest.raises(UsageError, match="another matrix"):
        do("stopped", matrix=replace(SMALL, seed=SEED + 1))


def test_a_drive_that_fails_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(trial: Any, *_: Any) -> Any:
        raise ValueError("no road")

    monkeypatch.setattr(run, "_rules", lambda *_: {})
    monkeypatch.setattr(run, "samples", broken)
    with pytest.raises(RuntimeError, match=r"trial 0 \(us06, vehicle 2000, reference\).*no road"):
        run.run(SMALL, shipped_model(), config.load(), tmp_path / "out", lambda _: None)


def test_a_model_that_cannot_judge_the_drives_is_the_users_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unfit(*_: Any, **__: Any) -> Any:
        raise RecordingError("the model needs boost_kpa")

    monkeypatch.setattr(run, "_rules", lambda *_: {})
    monkeypatch.setattr(run, "judge_drives", unfit)
    with pytest.raises(RecordingError, match="needs boost_kpa"):
        run.run(SMALL, shipped_model(), config.load(), tmp_path / "out", lambda _: None)


def test_the_command_drives_a_small_matrix_and_reports_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # GIVEN few drives for the literature's rules
    few = calibration(SMALL)
    monkeypatch.setattr(
        run,
        "calibration",
        lambda _: (
            [
                replace(t, cycle="hwfet", ambient="mild", conditions=weather("hot", t.seed))
                for t in few[0][:3]
            ],
            few[1][:1],
        ),
    )
    monkeypatch.setattr("benchmarks.studies.rules.alarms.FALSE_ALARM_RATE", 0.05)
    # WHEN the matrix is driven
    args = [
        "--out",
        str(tmp_path / "m"),
        "--vehicles",
        "2",
        "--first-vehicle",
        str(FIRST),
        "--seed",
        str(SEED),
        "--healthy",
        "2",
        "--repetitions",
        "1",
        "--reference-drives",
        "1",
        "--cycles",
        "us06",
        "--jobs",
        "1",
        "--ambients",
        "mild",
        "--faults",
        "delay_symmetric=0.4,2",
        "signal_missing",
    ]
    assert main(args) == 0
    # THEN both faults are found, and text, JSON and page say so
    result = json.loads((tmp_path / "m" / "matrix.json").read_text())
    assert result["schema"] == "o2train.matrix/1"
    assert result["source"] == "simulated"
    assert result["drives"]["all"] == 9
    cells = {(d["severity"], d["placement"]): d["named"]["events"] for d in result["detection"]}
    assert cells[2.0, "loop"] == cells[2.0, "after"] == cells[1.0, "loop"] == 1
    html = (tmp_path / "m" / "report.html").read_text()
    assert "Everything here is simulated: 9 drives" in html
    assert "these figures are not final" in html  # of vehicles for development
    assert html.count("data:image/svg+xml") == 6
    assert "9 simulated drives" in capsys.readouterr().out
    # WHEN it is asked for again THEN nothing is driven anew
    monkeypatch.setattr(run, "samples", None)
    monkeypatch.setattr(run, "_rules", lambda *_: {})
    assert main(args) == 0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--faults", "rusty"], "fault 'rusty' is unknown"),
        (["--faults", "gain_low=1.5"], "wanted below 1"),
        (["--cycles", "nowhere"], "cycle 'nowhere' is unknown"),
        (["--ambients", "damp"], "ambient 'damp' is unknown"),
        (["--vehicles", "0"], "--vehicles is at least 1"),
        (["--first-vehicle", "1"], "vehicle 1 has trained the model"),
    ],
)
def test_what_cannot_be_driven_is_said_in_one_line(
    options: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = ["--first-vehicle", str(FIRST), "--seed", str(SEED), "--out", str(tmp_path / "m")]
    assert main([*own, *options]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert len(error.splitlines()) == 1
