"""``o2mon doctor LOG``: from logs to a verdict on one page, by the commands that it prints."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from monitor.cli import log_doctor, main
from tests.conftest import ROOT
from training.cli import main as o2train

LATE = ROOT / "replay_logs" / "delay_symmetric_micro_trips_v108_s112.blf"
SHIPPED = ROOT / "monitor" / "model" / "shipped.onnx"
Output = pytest.CaptureFixture[str]


def test_a_model_is_fitted_to_healthy_logs_and_all_stands_on_one_page(
    tmp_path: Path, capfd: Output
) -> None:
    # GIVEN a healthy drive and another one of the same car
    words = ["simulate", "--out", str(tmp_path), "--format", "csv", "--period", "0.1"]
    for seed in ("1", "2"):
        assert o2train([*words, "--duration", "200", "--seed", seed]) == 0
    healthy, drive = sorted(map(str, tmp_path.glob("*.csv")))
    out = tmp_path / "doctor"
    # WHEN the doctor is asked THEN it prints the steps, which stand on the page of the verdict
    call = ["doctor", drive, "--healthy", healthy, "--out", str(out), "--budget", "0.01"]
    assert main(call) in (0, 1, 3)
    said = capfd.readouterr().out
    steps = (
        f"o2train fit {healthy} --out {out}/car.onnx --budget 0.01",
        f"o2mon check {drive} --model {out}/car.onnx",
        f"o2train tables {healthy} --out {out}/tables",
    )
    assert [line[2:] for line in said.splitlines() if line.startswith("$ ")] == list(steps)
    page = (out / "report.html").read_text()
    assert re.findall(r"<summary><code>(o2.*?)</code>", page) == list(steps)
    # AND the tables, with every cell that is filled
    assert 'href="tables/report.html"' in page and (out / "tables" / "report.html").exists()
    tables = json.loads((out / "tables" / "tables.json").read_text())["tables"]
    filled = sum(np.isfinite(np.array(t["estimate"], float)).sum() for t in tables)
    assert re.findall("<pre>(.*?)</pre>", page, re.S)[-1].count("±") == filled > 10


@pytest.fixture
def no_training(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let o2train say that its libraries are missing, as in an installation of the runtime."""
    text = "import sys\nprint('o2train: torch is not installed', file=sys.stderr)\nsys.exit(2)\n"
    (tmp_path / "no_o2train.py").write_text(text)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{ROOT}")
    monkeypatch.setitem(log_doctor._MODULES, "o2train", "no_o2train")


@pytest.mark.usefixtures("no_training")
def test_without_training_a_model_judges_without_tables(tmp_path: Path, capfd: Output) -> None:
    (tmp_path / "my.toml").write_text("[enable]\nengine_speed_max_rpm = 4000.0\n")
    call = ["doctor", str(LATE), "--channel", "1", "--model", str(SHIPPED)]
    call += ["--config", str(tmp_path / "my.toml"), "--out", str(tmp_path / "out")]
    assert main(call) == 1
    said = capfd.readouterr().out
    assert f"--channel 1 --config {tmp_path}/my.toml\n" in said
    assert said.count("--channel 1") == 2 and "  o2train: torch is not installed" in said
    assert "FAULT: P015A delay_symmetric" in said
    page = tmp_path / "out" / "report.html"
    assert "torch is not installed" in page.read_text()
    page.write_text("my own page")
    assert main(call) == 2
    assert "report.html: is there already; --force" in capfd.readouterr().err
    assert main([*call, "--force"]) == 1  # which reaches the steps
    assert re.search(r"\$ o2train tables .*--force", capfd.readouterr().out)


@pytest.mark.usefixtures("no_training")
def test_a_step_that_fails_ends_the_diagnosis_with_its_name(tmp_path: Path, capfd: Output) -> None:
    out = str(tmp_path / "out")
    assert main(["doctor", str(LATE), "--healthy", str(LATE), "--out", out]) == 2
    errors = capfd.readouterr().err.splitlines()
    assert errors[0] == "o2train: torch is not installed"
    assert errors[-1].startswith(f"o2mon: the step failed: o2train fit {LATE}")


@pytest.mark.usefixtures("no_training")
@pytest.mark.parametrize("command", ["doctor", "check"])
def test_a_log_that_cannot_be_read_does_not_hide_what_the_others_say(
    command: str, tmp_path: Path, capfd: Output
) -> None:
    out = ["--out", str(tmp_path / "out")] if command == "doctor" else []
    assert main([command, str(tmp_path / "none.csv"), str(LATE), *out]) == 2
    said, errors = capfd.readouterr()
    assert "plausible" in said and ("FAULT: P015A delay_symmetric" in said) == bool(out)
    assert (f"$ o2train tables {LATE} " in said) == bool(out)  # without the log that cannot be read
    assert "none.csv: " in errors.splitlines()[-1] and "No such file" in errors.splitlines()[-1]


def test_a_log_and_a_bus_are_not_examined_together(capfd: Output) -> None:
    assert main(["doctor", str(LATE), "-i", "virtual", "-c", "x"]) == 2
    assert main(["doctor", str(LATE), "--scan"]) == 2
    assert main(["doctor", "--healthy", str(LATE)]) == 2
    *of_both, of_none = capfd.readouterr().err.splitlines()
    assert [line.count("is for a bus, not for a CAN log") for line in of_both] == [1, 1]
    assert "nothing to examine: give a LOG" in of_none
