"""``o2train study`` from end to end on tanks, killed and resumed; bad input; the choice."""

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser

from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray, Quality
from tests.helpers.bus.chromium import plots_of
from tests.helpers.models.plants import TANK_PERIOD_S as PERIOD_S
from tests.helpers.models.plants import leaking_tank
from training.cli import main
from training.limits.trust import LIMIT_FAULTS
from training.narx.network import Spec, initial_weights
from training.recordings.recording import load
from training.recordings.samples.preparation import prepare
from training.study.choice import decide
from training.study.driving.effort import effort
from training.study.driving.steady import steady_against_mixed
from training.study.free_runs import WINDOW, FreeRun, scaled_as
from training.study.page import confidence, section
from training.study.sensor import against_sensor, residuals
from training.study.task import Settings, Task

SIGNALS = ["--inputs", "valve", "leak", "--output", "level_m"]
SMALL = [
    *("--starts", "1", "--iterations", "5", "--models", "1", "6", "--samples", "1500"),
    *("--budget", "0.02", "--jobs", "1"),
]
PARTS = [
    *("check", "preparation", "selection", "linear", "narx", "free", "choice", "shipped"),
    *("beside", "sensor", "steady", "effort"),
]


def tank(n: int, seed: int, longest: int = 60) -> FloatArray:
    """Time, valve, leak and level of a tank, side by side."""
    valve, leak, level = leaking_tank(n, seed, 0.8, longest)
    return np.column_stack([np.arange(n) * PERIOD_S, valve, leak, level])


def write(path: Path, values: FloatArray, names: str = "time_s,valve,leak,level_m") -> Path:
    np.savetxt(path, values, delimiter=",", header=names, comments="", fmt="%.6g")
    return path


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("drives")
    return {
        "morning": write(folder / "morning.csv", tank(1800, 1)),
        "evening": write(folder / "evening.csv", tank(1200, 2)),
        "test": write(folder / "test.csv", tank(700, 3)),
        "steady": write(folder / "steady.csv", tank(2300, 4, longest=400)),
    }


@pytest.fixture(scope="module")
def command(drives: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    out = tmp_path_factory.mktemp("study") / "out"
    train = [str(drives["morning"]), str(drives["evening"])]
    others = ["--test", str(drives["test"]), "--steady", str(drives["steady"])]
    return ["study", *train, *others, *SIGNALS, *SMALL, "--out", str(out)]


@pytest.fixture(scope="module")
def killed(command: list[str]) -> dict[str, int]:
    """Kill the study as soon as its NARX models begin; return the finished parts' times."""
    out = Path(command[-1])
    root = Path(__file__).resolve().parents[3]
    line = [sys.executable, "-m", "training.cli", *command]
    process = subprocess.Popen(line, stdout=subprocess.DEVNULL, cwd=root)
    deadline_s = time.monotonic() + 120
    while not (out / "parts" / "linear.json").exists():
        assert process.poll() is None and time.monotonic() < deadline_s
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    return {p.name: p.stat().st_mtime_ns for p in (out / "parts").glob("*.json")}


@pytest.fixture(scope="module")
def result(killed: dict[str, int], command: list[str]) -> dict[str, Any]:
    assert killed and main(command) == 0
    text = (Path(command[-1]) / "study.json").read_text()
    return dict(json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON")))


def test_a_killed_study_goes_on_where_it_was(
    killed: dict[str, int], result: dict[str, Any], command: list[str]
) -> None:
    out = Path(command[-1])
    assert {"check.json", "preparation.json", "selection.json", "linear.json"} <= set(killed)
    assert "choice.json" not in killed
    assert result["schema"] == "o2train.study/1"
    for name, written_ns in killed.items():
        assert (out / "parts" / name).stat().st_mtime_ns == written_ns, name


def test_its_plots_are_drawn(result: dict[str, Any], command: list[str], browser: Browser) -> None:
    impulses, views = len(result["linear"]["impulse"]["rows"]), len(result["sensor"]["views"])
    faults = len(result["sensor"]["faults"])
    wanted = 2 + 1 + impulses + 3 + 2 * views + faults + 2 * min(faults, 6)
    assert plots_of(browser, Path(command[-1]) / "report.html") == wanted


def test_a_finished_study_is_only_written_again(
    result: dict[str, Any], command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(command) == 0
    assert capsys.readouterr().out.count("as stored") == len(PARTS)


def test_a_job_that_vanished_is_done_again(result: dict[str, Any], command: list[str]) -> None:
    parts = Path(command[-1]) / "parts"
    (parts / "choice.json").unlink()
    (parts / "narx" / f"{result['narx']['tuned'][0]['weights_key']}.json").unlink()
    assert main(command) == 0


def test_study_json_holds_every_part_and_its_figures(result: dict[str, Any]) -> None:
    assert set(PARTS) <= set(result)
    assert not [p for p in PARTS if "skipped" in result[p]]
    chosen = result["choice"]["candidates"][result["choice"]["chosen"]]
    held_out = result["sensor"]["views"][-1]
    assert held_out["title"] == "test.csv" and held_out["source"] == "recorded"
    assert held_out["all"]["fit_percent"] == pytest.approx(chosen["after"]["all"]["fit_percent"])
    assert held_out["all"]["correlation"] > 0.9
    assert result["beside"]["parameters"] == chosen["n_weights"]


def test_closed_loop_training_is_set_beside_one_step_training(result: dict[str, Any]) -> None:
    chosen = result["choice"]["candidates"][result["choice"]["chosen"]]
    assert chosen["after"]["all"]["rmse"] < chosen["before"]["all"]["rmse"]


def test_faults_put_on_afterwards_widen_the_residual(result: dict[str, Any]) -> None:
    healthy, faults = result["sensor"]["healthy"], result["sensor"]["faults"]
    assert {f["how"] for f in faults} == {"put on afterwards"}
    late = next(f for f in faults if f["name"].startswith("delay_symmetric"))
    assert late["std"] > healthy["std"]


def test_steady_training_sees_less_of_the_transients(result: dict[str, Any]) -> None:
    steady, mixed = (result["steady"]["models"][k] for k in ("steady", "mixed"))
    assert abs(steady["samples"] - mixed["samples"]) < 0.1 * mixed["samples"]


def test_the_effort_is_told_for_parts_of_the_driving(result: dict[str, Any]) -> None:
    parts = result["effort"]["parts"]
    assert [part["minutes"] for part in parts] == [5.0, 10.0, 12.5]
    assert all(0 <= part["found"] <= part["put_on"] for part in parts)
    assert parts[-1]["put_on"] > 0 or parts[-1]["why"]


def test_a_held_out_drive_that_is_not_judged_is_none_in_which_a_fault_was_missed(
    drives: dict[str, Path], tmp_path: Path
) -> None:
    held_out = load(drives["test"])
    driven = load(write(tmp_path / "day.csv", tank(3000, 2)))
    used = (driven,), (held_out, held_out.part(0, 60)), (), ()
    task = Task(*used, ("valve", "leak"), "level_m", tmp_path, Settings(budget_minutes=0.05))
    task.folder.mkdir()
    assert effort(task, {})["parts"][-1]["put_on"] == len(LIMIT_FAULTS) - 2  # of one drive


def test_the_report_stands_alone(result: dict[str, Any], command: list[str]) -> None:
    text = (Path(command[-1]) / "report.html").read_text()
    shown = re.sub(r"<(script|style)[^>]*>.*?</\1>", "", text, flags=re.DOTALL)
    assert not re.findall(r"(?:src|href)=\"(?!#)[^\"]", shown)
    assert "://" not in shown and "nan" not in shown.split()
    for target in re.findall(r'href="#([^"]+)"', shown):
        assert f'id="{target}"' in shown
    assert shown.count("<h2") == 14
    for asked in ("How good", "than a linear", "paper's rule find", "much driving", "data enough"):
        assert asked in shown[: shown.index("<table")]
    for warning in result["warnings"]:
        assert warning.split("<")[0][:40] in shown


def test_the_model_evaluates_as_the_study_says(
    result: dict[str, Any], drives: dict[str, Path], command: list[str], tmp_path: Path
) -> None:
    model, out = Path(command[-1]) / "model.onnx", tmp_path / "figures.json"
    assert main(["evaluate", "--model", str(model), str(drives["test"]), "--json", str(out)]) == 0
    figures = json.loads(out.read_text())["recordings"][0]
    said = result["sensor"]["views"][-1]["all"]
    assert figures["rmse"] == pytest.approx(said["rmse"], rel=0.05)


UNUSABLE: dict[str, Callable[..., tuple[FloatArray, ...]]] = {
    "leak": lambda t, valve, leak, level: (t, valve, 0.0 * leak + 0.5, level),
    "copy of the output": lambda t, valve, leak, level: (t, valve, 3.0 * level + 1.0, level),
    "samples": lambda t, *others: (t[:30], *(x[::30][:30] for x in others)),
    "level_m": lambda t, valve, leak, level: (t, valve, leak, np.nan * level),
}


@pytest.mark.parametrize("says", UNUSABLE)
def test_recordings_that_cannot_train_end_with_one_clear_line(
    says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path / "bad.csv", np.column_stack(UNUSABLE[says](*tank(900, 5).T)))
    assert main(["study", str(path), *SIGNALS, *SMALL, "--out", str(tmp_path / "out")]) == 2
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert says in last and last.startswith("o2train: ") and "Traceback" not in last
    assert not (tmp_path / "out" / "model.onnx").exists()


def test_recordings_that_do_not_fit_together_are_named(
    drives: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = str(drives["morning"])
    slow = str(write(tmp_path / "slow.csv", tank(900, 6) * [2, 1, 1, 1]))
    other = str(write(tmp_path / "slower.csv", tank(900, 6)))
    without = str(write(tmp_path / "without.csv", tank(900, 6), "time_s,valve,drain,level_m"))
    for extra, says in (
        ([slow], "sample period 0.5 s"),
        (["--test", without], "without.csv: has no leak"),
        (["--test", good], "the same as"),
        ([good], "the same as"),
        (["--test", other, "--faulty", other], "slower.csv: the same as"),
        (["--models", "77"], "wanted numbers 1 to 29"),
    ):
        out = str(tmp_path / "out")
        assert main(["study", good, *extra, *SIGNALS, "--out", out]) == 2
        assert says in capsys.readouterr().err.strip().splitlines()[-1]


def test_without_torch_no_work_is_done(
    drives: dict[str, Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    assert main(["study", str(drives["morning"]), *SIGNALS, "--out", "never"]) == 2
    assert "torch is not installed: pip install '.[study]'" in capsys.readouterr().err


def candidate(rmse: float, n_weights: int, *, forgets: bool = True) -> dict[str, Any]:
    own = {"validation_rmse": rmse, "n_weights": n_weights, "forgets": forgets}
    return own | {"name": f"{n_weights}", "structure": ""}


def test_of_models_that_are_not_told_apart_the_smaller_is_chosen() -> None:
    blocks = np.linspace(0.5, 2.0, 30)
    noisy = blocks * np.tile([0.8, 1.24], 15)  # 2 % worse, but not in every block
    worse = 1.5 * blocks
    sizes = ((blocks, 400), (noisy, 80), (worse, 20))
    rows = [candidate(float(np.sqrt(b.sum())), n) for b, n in sizes]
    chosen, equal, reason = decide(rows, [blocks, noisy, worse], strict=True)
    assert chosen == 1 and 2 not in equal and "smaller" in reason


def test_for_lambda_a_model_that_does_not_forget_comes_last() -> None:
    blocks = np.linspace(1.0, 2.0, 20)
    rows = [candidate(1.0, 100, forgets=False), candidate(2.0, 100) | {"after": {"all": {}}}]
    chosen, equal, reason = decide(rows, [blocks, 4 * blocks], strict=True)
    assert chosen == 1 and reason.endswith("1 of 2 do not forget their history and come last.")
    told = confidence({"candidates": rows, "chosen": chosen, "equal": equal})
    assert told.startswith("no other model that forgets its history is as good")
    assert decide(rows, [blocks, 4 * blocks], strict=False)[0] == 0
    with pytest.raises(RecordingError, match="every training diverged"):
        decide([candidate(float("nan"), 5)], [blocks], strict=True)


def test_other_drives_are_scaled_as_the_training_was(drives: dict[str, Path]) -> None:
    recording = load(drives["morning"])
    data = prepare([recording], ["valve", "leak"], "level_m")
    again = scaled_as(data, [recording])
    np.testing.assert_allclose(again.samples.u, data.samples.u)
    inside = np.abs(again.samples.y) < 0.9 * np.abs(data.scaling.y_scaled_limits).min()
    np.testing.assert_allclose(again.samples.y[inside], data.samples.y[inside])


def test_a_reading_pinned_at_the_end_of_its_range_is_not_judged(drives: dict[str, Path]) -> None:
    recording = load(drives["morning"])
    data = prepare([recording], ["valve", "leak"], "level_m")
    recording.quality[300:320, 2] = Quality.PINNED
    assert np.flatnonzero(~scaled_as(data, [recording]).enabled).tolist() == list(range(300, 320))


def test_a_missing_signal_is_compared_with_nothing(drives: dict[str, Path], tmp_path: Path) -> None:
    path = write(tmp_path / "lost.csv", tank(400, 8) * [1, 1, 1, np.nan])
    used = *((load(drives[name]),) for name in ("morning", "test")), (load(path),), ()
    task = Task(*used, ("valve", "leak"), "level_m", tmp_path, Settings())
    spec = Spec(2, 3, (3,))
    weights = initial_weights(spec, np.random.default_rng(0))
    network = {"spec": asdict(spec), "weights": weights.tolist(), "one_step_weights": None}
    free, shipped = network | {"stage": "none"}, {"limits": {}}
    parts = {"narx": {}, "free": free, "choice": {"chosen": 0}, "shipped": shipped}
    found = against_sensor(task, parts)
    assert found["unreadable"] == ["lost.csv"] and found["faults"] == []
    assert "Nothing to compare in lost.csv" in section("faulty", {"sensor": found})


def test_steady_drives_need_others_to_judge(drives: dict[str, Path], tmp_path: Path) -> None:
    one = (load(drives["steady"]),)
    task = Task(one, (), (), one, ("valve", "leak"), "level_m", tmp_path, Settings())
    with pytest.raises(RecordingError, match="--test"):
        steady_against_mixed(task, {})
    few = replace(task, test=(load(drives["test"]),), settings=Settings(n_samples=900))
    with pytest.raises(RecordingError, match="900 by --samples: 1500 of each are wanted"):
        steady_against_mixed(few, {})


def test_a_drive_whose_reading_stands_still_has_no_fit(drives: dict[str, Path]) -> None:
    stuck = load(drives["test"])
    stuck.values[:, 2] = 0.7  # the mean of so many is rounded
    data = scaled_as(prepare([load(drives["morning"])], ["valve", "leak"], "level_m"), [stuck])
    run = FreeRun(data, np.linspace(0.0, 1.0, len(data.role)), data.role >= 0)
    assert run.errors()["all"].keys() == {"samples"}


def test_windows_are_fifty_unbroken_samples(drives: dict[str, Path]) -> None:
    recording = load(drives["test"])
    data = scaled_as(prepare([load(drives["morning"])], ["valve", "leak"], "level_m"), [recording])
    measured = data.scaling.unscale_y(data.samples.y)
    rows = np.ones(len(measured), dtype=bool)
    rows[120] = False  # breaks the third window
    run = FreeRun(data, measured - 0.3, rows)
    found = residuals(run, np.linspace(-1.0, 1.0, 81), {"j_mu": 0.2, "j_sigma": 0.1})
    assert found["windows"] == 120 // WINDOW + (len(rows) - 121) // WINDOW
    assert found["beyond"] == {"mean": 1.0, "std": 0.0, "both": 0.0}
    assert found["mean"] == pytest.approx(0.3)
