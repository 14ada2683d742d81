"""The grey-box model from command line to verdict."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from monitor import cli as o2mon
from monitor.model.step import Model
from tests.conftest import ROOT
from training.cli import main as o2train
from training.cli.fit import constant_line
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment
from training.greybox.charge import INPUTS
from training.healthy import new_model

Capture = pytest.CaptureFixture[str]

TRAINING = (("wltc_3b", 1001), ("udds", 1002), ("us06", 1003), ("micro_trips", 1036))  # cold to hot


@pytest.fixture(scope="module")
def training(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("training")
    return [write(Experiment(c, seed=s, duration_s=400.0), folder, "parquet") for c, s in TRAINING]


@pytest.fixture(scope="module", autouse=True)
def _without_reference() -> Iterator[None]:
    """Leave out what a fit learns for the gap workflow: it takes long and has tests of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(new_model, "GROUPS_LEAST", len(TRAINING) + 1)
        yield


@pytest.fixture(scope="module")
def model(training: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("model") / "chain.onnx"
    code = o2train(["fit", *map(str, training), "--kind", "greybox", "--out", str(out)])
    assert code == 0
    return out


def test_fit_writes_limits_and_a_report(model: Path) -> None:
    card = Model.load(model).card
    assert card.kind == "greybox"
    assert {"j_mu", "j_sigma", "noise", "offset"} <= set(card.limits)
    assert "the recordings of the fit" in card.limits["j_mu"].origin
    page = model.with_suffix(".html").read_text()
    for text in ("dead_time_revolutions", "standard error", "sandwich", "Held-out", "simulated"):
        assert text.lower() in page.lower()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--lags", "3"], "--lags: a grey-box model"),
        (["--budget", "5", "--wall", "3"], "--budget, --wall: a grey-box model"),
        (["--hidden", "4", "--lag-zero"], "--lag-zero, --hidden"),
        (["--output", "downstream_voltage_v"], "a grey-box model predicts lambda_measured alone"),
    ],
)
def test_options_of_another_model_are_refused(
    training: list[Path], tmp_path: Path, capsys: Capture, options: list[str], message: str
) -> None:
    arguments = ["fit", str(training[0]), "--kind", "greybox", "--out", str(tmp_path / "m.onnx")]
    assert o2train([*arguments, *options]) == 2
    assert message in capsys.readouterr().err.splitlines()[-1]


def test_a_recording_given_twice_is_refused(
    training: list[Path], tmp_path: Path, capsys: Capture
) -> None:
    first = str(training[0])
    out = str(tmp_path / "m.onnx")
    assert o2train(["fit", first, first, "--kind", "greybox", "--out", out]) == 2
    assert f"{first}: the same as {first}" in capsys.readouterr().err


@pytest.fixture(scope="module")
def dense(training: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The chain with its own charge, of one drive."""
    out = tmp_path_factory.mktemp("dense") / "chain.onnx"
    arguments = ["fit", str(training[1]), "--kind", "greybox", "--out", str(out)]
    assert o2train([*arguments, "--inputs", *INPUTS]) == 0
    return out


def test_a_constant_that_the_recordings_hardly_hold_has_no_standard_error_in_its_line() -> None:
    held = {"value": 1.01, "standard_error": 0.0005, "unit": "-"}
    assert constant_line("gain", held) == "constant gain: 1.0100 ± 0.0005 -"
    at_its_bound = {"value": 0.005, "standard_error": 1961.5, "unit": "s"}
    line = constant_line("mixing_s", at_its_bound)
    assert line == "constant mixing_s: 0.0050 s (the recordings hardly hold it)"


def test_the_report_says_where_the_charge_comes_from(model: Path, dense: Path) -> None:
    assert "air per stroke as recorded" in model.with_suffix(".html").read_text()
    assert "5 speeds by 6 pressures" in dense.with_suffix(".html").read_text()


def test_evaluate_takes_it_too(model: Path, training: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "figures.json"
    assert o2train(["evaluate", "--model", str(model), str(training[1]), "--json", str(out)]) == 0
    (found,) = json.loads(out.read_text())["recordings"]
    assert found["samples"] > 3_800
    assert found["enabled"]["correlation"] > 0.7


@pytest.mark.parametrize(
    ("log", "code"), [("healthy_micro_trips_v102_s102.blf", 0), ("gain_low_micro_trips", 1)]
)
def test_the_monitor_runs_it_unchanged(model: Path, log: str, code: int, capsys: Capture) -> None:
    (path,) = (ROOT / "replay_logs").glob(f"{log}*")
    assert o2mon.main(["replay", str(path), "--model", str(model)]) == code
    assert ("gain_low" in capsys.readouterr().out) == bool(code)
