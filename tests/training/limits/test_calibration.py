"""Limits from healthy drives, on simulated drives with the fault in the control loop."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest
from playwright.sync_api import Browser
from scipy import stats

from monitor.base import config, faults
from monitor.base.errors import RecordingError, UsageError
from monitor.judge.limits import Limits
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.bus.chromium import plots_of
from tests.helpers.drives.drive_tables import Columns, table
from tests.helpers.drives.simulated_drives import WARM
from training.cli import main
from training.dyno import tailpipe
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment
from training.limits.calibration import calibrate
from training.limits.calibration_page import detection
from training.limits.decision_limits import limits_of
from training.limits.evaluation import evaluate
from training.limits.judging import judge_recordings, why_not
from training.limits.rates import rate
from training.recordings.recording import Recording, load

Capture = pytest.CaptureFixture[str]
HIGHWAY = Experiment(cycle="hwfet", conditions=WARM)


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drives")
    for seed in (9101, 9102, 9103, 9104, 9105):
        write(replace(HIGHWAY, seed=seed), folder, "parquet")
    for name, severity in (("slow_symmetric", 0.6), ("delay_lean_to_rich", 0.5)):
        fault = faults.resolve(name, severity)
        write(replace(HIGHWAY, seed=9106, fault=fault), folder, "parquet")
    return folder


@pytest.fixture(scope="module")
def calibrated(drives: Path) -> Path:
    """A model calibrated on the first three healthy drives and both faulty ones."""
    model = drives / "model.onnx"
    shutil.copyfile(shipped_model(), model)
    files = {"--out": "calibrated.onnx", "--json": "figures.json", "--report": "page.html"}
    written = [word for option, name in files.items() for word in (option, str(drives / name))]
    with pytest.MonkeyPatch.context() as patch:  # of seven faults in many steps, one in three
        patch.setattr(tailpipe, "SEVERITIES", {"gain_low": (0.9, 0.1)})
        patch.setattr(tailpipe, "STEPS", 3)
        patch.setattr(tailpipe, "SETTINGS", {"gain_weak_max": ("gain_low",)})
        assert main([*command(drives), *written, "--emission-limit", "1.5"]) == 0
    return drives / "calibrated.onnx"


def healthy(folder: Path) -> list[Path]:
    return sorted(folder.glob("*_healthy.parquet"))


def command(folder: Path) -> list[str]:
    sound = map(str, healthy(folder)[:3])
    faulty = map(str, sorted(folder.glob("*_s9106_*.parquet")))
    model = str(folder / "model.onnx")
    return ["calibrate", "--model", model, "--healthy", *sound, "--faulty", *faulty]


def test_a_healthy_drive_counts_once_in_the_rate_of_false_alarms(drives: Path) -> None:
    twice = [load(healthy(drives)[0])] * 2
    with pytest.raises(UsageError, match="the same as"):
        evaluate(shipped_model(), twice, healthy=True)


def test_the_evidence_of_each_is_drawn(drives: Path, calibrated: Path, browser: Browser) -> None:
    assert plots_of(browser, drives / "page.html") == 1


@pytest.mark.parametrize(
    ("faults_given", "said"),
    [
        ([None, None], " %)"),  # recordings without a manifest
        (["transient", None], " %), 1 of 1 with the right name alone"),
    ],
)
def test_the_right_name_is_told_of_drives_whose_fault_is_known(
    faults_given: list[str | None], said: str
) -> None:
    known = sum(fault is not None for fault in faults_given)
    faulty = [{"fault": fault} for fault in faults_given]
    found = rate(2, 2) | {"named": known}
    assert detection({"found": found, "faulty": faulty}).endswith(said)


def test_false_alarms_on_drives_said_to_be_healthy_stand_beside_what_the_limits_state(
    drives: Path, calibrated: Path, capsys: Capture
) -> None:
    # GIVEN two drives with a sound sensor and one with a late one WHEN all are said to be healthy
    sound = [str(path) for path in healthy(drives)[3:]]
    late = str(next(drives.glob("*_delay_lean_to_rich*.parquet")))
    figures = drives / "evaluated.json"
    options = ["--model", str(calibrated), "--healthy", "--json", str(figures)]
    assert main(["evaluate", *sound, late, *options]) == 0
    # THEN the late one alone is a false alarm, and the rate that three drives can prove is said
    found = json.loads(figures.read_text())["false_alarms"]
    assert (found["events"], found["trials"], found["completed"]) == (1, 3, 3)
    assert found["named"] == {late: ["delay_lean_to_rich"]}
    assert found["stated"] < found["provable"] == 0.25
    out = capsys.readouterr().out
    assert "1 of 3 (95 %: 0.8 to 90.6 %); the limits state at most 0.001 % of drives" in out
    assert "and 3 drives can prove 25.0 % at best; " in out


def test_faulty_sensors_are_found_and_the_figures_say_so(drives: Path, calibrated: Path) -> None:
    result = json.loads((drives / "figures.json").read_text())
    rows = {row["fault"]: row for row in result["faulty"]}
    model, settings = Model.load(calibrated), config.load()
    limits = Limits.from_card(model.card, settings, str(calibrated))
    for name, code in (("slow_symmetric", "P0133"), ("delay_lean_to_rich", "P015B")):
        row = rows[name]
        drive = load(drives / row["recording"], period_s=0.1)
        own = judge_recordings([drive], model, limits, settings)[0].windows
        assert row["windows"] == len(own)
        assert row["paper_failed"] == sum(w.paper_failed for w in own)
        assert row["evidence"] > result["needed"]
        assert code in row["codes"]
    own, found = result["false_alarms"], result["found"]
    assert own["events"] == 0 < own["high"] < 1
    assert own["provable"] == 0.25
    assert found["events"] == found["trials"] == len(result["faulty"]) >= found["named"] > 0
    assert all(row["evidence"] < result["needed"] for row in result["healthy"])


def test_a_fault_of_the_sensor_behind_the_catalyst_is_found(drives: Path, tmp_path: Path) -> None:
    # GIVEN a drive whose downstream sensor is shorted to ground
    call = ["simulate", "--out", str(tmp_path), "--format", "parquet", "--period", "0.1"]
    assert main([*call, "--cycle", "hwfet", "--duration", "200", "--fault", "downstream_low"]) == 0
    faulty = load(next(tmp_path.glob("*.parquet")), period_s=0.1)
    sound = [load(path, period_s=0.1) for path in healthy(drives)[:2]]
    # WHEN limits are set with it THEN its code counts
    result = calibrate(shipped_model(), sound, [faulty], config.load())[1]
    assert [row["codes"] for row in result["faulty"]] == [["P0137"]]
    assert (result["found"]["events"], result["found"]["named"]) == (1, 1)


def test_only_limits_and_trust_of_the_file_change(drives: Path, calibrated: Path) -> None:
    old, new = (Model.load(p).card for p in (drives / "model.onnx", calibrated))
    assert replace(new, limits=old.limits, trust=old.trust) == old
    assert new.graph_sha256 == old.graph_sha256
    assert new.limits["j_mu"] != old.limits["j_mu"]
    # older cards lack two of them
    assert new.limits.keys() == old.limits.keys() | {"evidence", "gain_model"}
    assert 0.0 < new.limits["evidence"].value <= 1.0


def test_the_card_says_where_its_limits_come_from(drives: Path, calibrated: Path) -> None:
    limits = Model.load(calibrated).card.limits
    result = json.loads((drives / "figures.json").read_text())
    windows = sum(row["windows"] for row in result["healthy"])
    for name in ("j_mu", "j_sigma", "noise", "offset"):
        assert f"{windows} healthy windows, o2train calibrate, 3 healthy" in limits[name].origin
    told = {x["name"]: x["value"] for x in result["limits"]}
    assert told == {name: limit.value for name, limit in limits.items()}


def test_the_page_calls_simulated_drives_simulated(drives: Path, calibrated: Path) -> None:
    text = (drives / "page.html").read_text()
    assert text.count("healthy.parquet (simulated)") == 3
    assert "slow_symmetric 0.6" in text
    assert "delay_lean_to_rich 0.5" in text
    weak = json.loads((drives / "figures.json").read_text())["emissions"]["response"]
    assert f"gain_weak_max = {weak['gain_weak_max']:g}" in text and "simulated car" in text


def test_faulty_drives_change_no_limit(drives: Path, calibrated: Path) -> None:
    paths = healthy(drives)[:3]
    recordings = [load(path, period_s=0.1) for path in paths]
    card, result = calibrate(drives / "model.onnx", recordings, [], config.load())
    assert Model.load(calibrated).card.limits == card.limits
    assert result["found"]["rate"] is None
    assert any("3 healthy drives with windows" in text for text in result["warnings"])


def test_a_drive_that_the_model_was_trained_on_is_told(drives: Path) -> None:
    path = healthy(drives)[1]
    known = Model.load(shipped_model()).card.recordings[0].sha256
    recording = replace(load(path, period_s=0.1), sha256=known)
    _, result = calibrate(shipped_model(), [recording], [], config.load())
    assert any("the model was trained on it" in text for text in result["warnings"])


def test_too_few_windows_are_refused_and_the_model_stays(
    drives: Path, calibrated: Path, tmp_path: Path, capsys: Capture
) -> None:
    before = (drives / "model.onnx").read_bytes()
    short = tmp_path / "short.csv"
    table = pl.read_parquet(drives / "hwfet_v1_s9101_healthy.parquet")
    table.head(len(table) // 20).write_csv(short)
    given = ["--model", str(drives / "model.onnx"), "--healthy", str(short)]
    assert main(["calibrate", *given]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "healthy windows, 10 are wanted" in error
    assert (drives / "model.onnx").read_bytes() == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (["--healthy", "{faulty}"], "given as healthy, its manifest says slow_symmetric"),
        (["--faulty", "{healthy}"], "the same as"),
        (["--faulty", "{other}"], "given as faulty, its manifest says healthy"),
        (["--out", "{folder}/model.txt"], "ends in .onnx"),
        (["--report", "{folder}/no/page.html"], "the folder does not exist"),
        (["--model", "{folder}/none.onnx"], "none.onnx"),
        (["--emission-limit", "1"], "more than 1 is wanted"),
    ],
)
def test_what_cannot_be_is_one_line(
    change: list[str], message: str, drives: Path, calibrated: Path, capsys: Capture
) -> None:
    files = {
        "faulty": drives / "hwfet_v1_s9106_slow_symmetric.parquet",
        "healthy": drives / "hwfet_v1_s9101_healthy.parquet",
        "other": drives / "hwfet_v1_s9105_healthy.parquet",
        "folder": drives,
    }
    assert main([*command(drives), *(each.format(**files) for each in change)]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(("k", "n"), [(0, 30), (3, 30), (30, 30)])
def test_bounds_of_a_rate_are_those_of_clopper_and_pearson(k: int, n: int) -> None:
    low = stats.beta.ppf(0.025, k, n - k + 1) if k else 0.0
    high = stats.beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
    found = rate(k, n)
    assert (found["low"], found["high"]) == pytest.approx((low, high), abs=1e-6)


CONFIG = config.load()
CARD = Model.load(shipped_model()).card


def recording(path: Path, **changes: float) -> Recording:
    def change(data: Columns) -> None:
        for name, value in changes.items():
            data[name][:] = value

    return load(table(path, change))


def test_a_column_of_zeros_is_named_instead_of_more_recordings(tmp_path: Path) -> None:
    zeros = recording(tmp_path / "zeros.csv", vehicle_speed_km_h=0.0)
    with pytest.raises(RecordingError, match="0 healthy windows") as raised:
        limits_of([[]], CARD, CONFIG, "test", [zeros])
    assert "vehicle_speed_km_h is 0 km/h throughout" in str(raised.value)
    assert "more or longer" not in str(raised.value)


def test_of_several_causes_the_commonest_is_named(tmp_path: Path) -> None:
    cold = recording(tmp_path / "cold.csv", coolant_temperature_degc=20.0)
    slow = [recording(tmp_path / f"{k}.csv", vehicle_speed_km_h=k) for k in (0.0, 3.0)]
    with pytest.raises(RecordingError, match=r"vehicle_speed_km_h is .* \(in 2 of 3 parts\)"):
        limits_of([[]], CARD, CONFIG, "test", [cold, *slow])


def test_nothing_is_wrong_with_an_ordinary_drive(tmp_path: Path) -> None:
    assert why_not(recording(tmp_path / "drive.csv"), CARD, CONFIG) == []


def test_a_short_drive_is_to_last_as_long_as_its_model_remembers(tmp_path: Path) -> None:
    slow = replace(CARD, checks={"contraction": {"samples": 400}})
    short = recording(tmp_path / "drive.csv").part(0, 30)
    assert why_not(short, slow, CONFIG)[0].advice.endswith("at least 45 s are wanted")
