"""Two road recordings of real vehicles, by no means made for this monitor.

What cannot be judged is said not to be judged, and why; a healthy car gets no code. Sources of the
recordings: data/README.md.
"""

import csv
import gzip
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from monitor import cli
from monitor.model.step import Model
from tests.helpers.logs.replays import replays
from training import cli as training_cli

# What of the MX-5 has a canonical name. Its vehicle speed always reads 0 and is left out.
MX5 = """
engine_speed_rpm = "rpm"
manifold_pressure_kpa = "map_kpa"
manifold_temperature_degc = "iat_c"
throttle_percent = "tps_pct"
coolant_temperature_degc = "clt_c"
battery_voltage_v = "battery_v"
lambda_measured = "lambda"
lambda_controller = { column = "ego_corr_pct", factor = 0.01 }
"""
# Guesses for what it lacks: the rail pressure of a port injection, air and fuel by rough factors.
GUESSED = """
air_mass_mg = { column = "map_kpa", factor = 4.6 }
fuel_mass_mg = { column = "pw_ms", factor = 4.5 }
maf_kg_h = { column = "map_kpa", factor = 0.5 }
rail_pressure_mpa = { column = "baro_kpa", factor = 0.003 }
"""
ME7 = 'engine_speed_rpm = "rpm"\nthrottle_percent = "tps_pct"\nlambda_measured = "lambda"\n'
INPUTS = ("engine_speed_rpm", "manifold_pressure_kpa", "throttle_percent", "pw_ms")
SMALL = ("--lags", "4", "--hidden", "6", "--starts", "1")
Rows = list[list[str]]
Replayed = Callable[..., tuple[int, str, dict[str, Any]]]


@pytest.fixture(scope="session")
def vehicles(shared_data: Path) -> Path:
    folder = shared_data / "vehicles"
    if not folder.is_dir():
        pytest.skip("the road recordings (../shared/data/vehicles) are not here")
    return folder


@pytest.fixture(scope="session")
def mx5(vehicles: Path) -> Path:
    """Give 32 minutes of an MX-5, with pauses, engine stops and a garbled battery channel."""
    return vehicles / "mx5_speeduino.csv.gz"


@pytest.fixture(scope="session")
def me7(vehicles: Path) -> Path:
    """Give eight minutes of road pulls of a turbo car; no fuel or air channel."""
    return vehicles / "me7_zeitronix.csv.gz"


def fitted(
    out: Path, recording: Path, columns: Path | None, *names: str, budget: str = "0.03"
) -> Path:
    mapped = ["--columns", str(columns)] if columns else []
    signals = ["--inputs", *names[:-1], "--output", names[-1], "--out", str(out)]
    size = [*SMALL, "--budget", budget]
    assert training_cli.main(["fit", str(recording), *mapped, *signals, *size]) == 0
    return out


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("vehicles")
    (found / "mx5.toml").write_text(MX5)
    (found / "guessed.toml").write_text(MX5 + GUESSED)
    (found / "me7.toml").write_text(ME7)
    return found


@pytest.fixture(scope="session")
def mx5_model(folder: Path, mx5: Path) -> Path:
    """Give a model of the MX-5 on canonical names."""
    return fitted(folder / "mx5.onnx", mx5, folder / "mx5.toml", *INPUTS, "lambda_measured")


@pytest.fixture
def replayed(capsys: pytest.CaptureFixture[str]) -> Replayed:
    """Give what replays a recording that can be read: exit code, what is said, the result."""

    def run(
        recording: Path, model: Path | None, columns: Path | None = None
    ) -> tuple[int, str, dict[str, Any]]:
        options = [f"--{k}={v}" for k, v in (("model", model), ("columns", columns)) if v]
        capsys.readouterr()  # what a fit before it warned of
        code, (found,) = replays(recording, *options)
        printed = capsys.readouterr()
        assert printed.err == ""
        return code, printed.out, found

    return run


def refused(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """Return the one line with which a replay is refused."""
    assert cli.main(["replay", *map(str, arguments)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


def edited(source: Path, out: Path, edit: Callable[[list[str], Rows], Rows]) -> Path:
    with gzip.open(source, "rt", newline="") as file:
        header, *rows = csv.reader(file)
    with out.open("w", newline="") as file:
        csv.writer(file).writerows([header, *edit(header, rows)])
    return out


def test_a_vehicle_unlike_the_models_is_not_judged_for_its_columns_times(
    mx5: Path, folder: Path, replayed: Replayed
) -> None:
    code, out, recording = replayed(mx5, None, folder / "guessed.toml")
    assert code == 3
    assert "not judged: response: maf_kg_h comes 0.082 s later against air_mass_mg" in out
    assert recording["dtcs"] == []


def test_a_model_too_poor_to_judge_its_own_healthy_car_says_so(
    mx5: Path, mx5_model: Path, folder: Path, replayed: Replayed
) -> None:
    code, out, recording = replayed(mx5, mx5_model, folder / "mx5.toml")
    assert code == 3
    assert recording["dtcs"] == []
    assert recording["samples"] > 19_000
    assert len(recording["windows"]) > 100
    assert re.search(
        "not judged: response: tried on 1 drive, the model finds none of its faults", out
    )
    page = mx5_model.with_suffix(".html").read_text()  # of the fit
    assert re.search("The model knows too little: tried on 1 drive, this model finds 0 of", page)
    assert "in its range for 62 % of the time: engine_speed_rpm is below 950 1/min" in out


def test_a_short_log_has_limits_of_its_twins_and_says_that_it_is_alone(
    replayed: Replayed, me7: Path, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # GIVEN a log with few windows
    short = edited(me7, folder / "third.csv", lambda _, rows: rows[: len(rows) // 3])
    names = ("engine_speed_rpm", "throttle_percent", "boost_raw", "lambda_measured")
    model = fitted(folder / "third.onnx", short, folder / "me7.toml", *names)
    # WHEN it is fitted THEN the limits are of twins that had not seen what they predict
    said = capsys.readouterr()
    alone = "one recording does not show how drives differ"
    assert alone in said.err and alone in (folder / "third.html").read_text()
    assert "a twin that had not seen it" in Model.load(model).card.limits["noise"].origin
    # THEN the log is judged, without a code
    code, _, recording = replayed(short, model, folder / "me7.toml")
    assert code in (0, 3)
    assert recording["dtcs"] == []
    assert recording["evidence"]


def test_a_model_with_too_few_windows_for_limits_judges_nothing_and_says_what_to_do(
    me7: Path, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    me7 = edited(me7, folder / "short.csv", lambda _, rows: rows[: len(rows) // 8])
    names = ("engine_speed_rpm", "throttle_percent", "boost_raw", "lambda_measured")
    model = fitted(folder / "me7.onnx", me7, folder / "me7.toml", *names)
    assert "no decision limits" in capsys.readouterr().err
    line = refused(capsys, me7, "--columns", folder / "me7.toml", "--model", model)
    assert "the model card has no limit" in line
    assert "o2train calibrate" in line


def test_a_healthy_car_gets_no_code_of_its_own(me7: Path, folder: Path, replayed: Replayed) -> None:
    model = fitted(folder / "me7own.onnx", me7, None, "rpm", "tps_pct", "boost_raw", "lambda")
    code, _, recording = replayed(me7, model)
    assert recording["dtcs"] == []
    assert code == (3 if recording["not_judged"] else 0)
