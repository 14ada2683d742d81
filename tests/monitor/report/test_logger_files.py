"""The logs of tuning tools through ``o2mon``: check, replay, profiles, Parquet."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor import cli
from monitor.base.errors import RecordingError
from monitor.grid import tables
from monitor.grid.tables import read_table
from tests.helpers.drives.drive_tables import table
from tests.helpers.logs.car_model import log_and_model
from tests.helpers.logs.logger_files import TUNER_UNITS, drive, write_text_table

Capture = pytest.CaptureFixture[str]
LAMBDA = "O2 Bank 1 Sensor 1 Wide Range Equivalence Ratio(λ)"
# the controller in per cent as well
UNITS = {**TUNER_UNITS, "lambda_controller": ("EGO", "", 0.01, 0.0)}


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return table(tmp_path_factory.mktemp("own") / "drive.csv")


def as_logged(own: Path, path: Path) -> tuple[Path, Path]:
    """Write the same drive as a logger would, and the profile that reads it."""
    canonical = read_table(own)
    columns: dict[str, list[str]] = {"t": [f"{1e3 * t:.3f}" for t in canonical.t_ns / 1e9]}
    units, lines = ["ms"], []
    for i, name in enumerate(canonical.names):
        column, unit, factor, offset = UNITS.get(name, (f"own {name}", "", 1.0, 0.0))
        cells = (canonical.values[:, i] - offset) / factor
        columns[column] = ["-" if np.isnan(x) else f"{x:.9g}".replace(".", ",") for x in cells]
        units.append(unit)
        scale = ", factor = 0.01" if name == "lambda_controller" else ""
        lines.append(f'{name} = {{ column = "{column}"{scale} }}')
    profile = path.with_suffix(".toml")
    profile.write_text('time = "t"\n[signals]\n' + "\n".join(lines) + "\n")
    columns["t"] = [text.replace(".", ",") for text in columns["t"]]
    write_text_table(path, columns, separator="\t", encoding="utf-16", units=units)
    return path, profile


def test_a_logger_s_file_is_judged_like_the_same_drive_in_canonical_columns(
    own: Path, tmp_path: Path
) -> None:
    # GIVEN a drive, and the same in psi, °F, mph, AFR, decimal commas, tabs and UTF-16
    log, profile = as_logged(own, tmp_path / "drive.msl")
    out = tmp_path / "out.json"
    found = {}
    for path, more in ((own, ()), (log, ("--profile", str(profile)))):
        page = ("--html", str(path.with_suffix(".html")))
        code = cli.main(["replay", str(path), "--quiet", "--json", str(out), *page, *more])
        found[path] = code, json.loads(out.read_text())["recordings"][0]
    (code, canonical), (same_code, logged) = found.values()
    assert code == same_code == 0
    assert logged["profile"] == "drive"
    assert "<code>drive</code>" in log.with_suffix(".html").read_text(encoding="utf-8")
    assert len(canonical["windows"]) == len(logged["windows"]) > 10
    means = [[w["mean"] for w in each["windows"]] for each in (canonical, logged)]
    np.testing.assert_allclose(means[0], means[1], atol=1e-5)
    enabled = [each["enabled_samples"] for each in (canonical, logged)]
    assert abs(enabled[0] - enabled[1]) <= 5  # of thousands: values at the edge of a range


READINGS = {LAMBDA: drive(300)["afr"] / 14.7}


def torque(path: Path, **more: np.ndarray | list[str]) -> Path:
    d = drive(n=300, period_s=1.0)
    names = {"Engine RPM(rpm)": d["rpm"], "Intake Manifold Pressure(psi)": d["map_kpa"] / 6.894757}
    clock = [f"{t // 60 % 60:02.0f}:{t % 60:04.1f}" for t in 3500.0 + d["t_s"]]
    return write_text_table(path, {"Device Time": clock, **names, **more})


def test_check_says_profile_range_and_what_is_missing(tmp_path: Path, capsys: Capture) -> None:
    assert cli.main(["check", str(torque(tmp_path / "drive.csv", **READINGS))]) == 0
    text = capsys.readouterr().out
    assert "profile: torque, recognised by its columns" in text
    assert "300 rows in 299.0 s, 1 rows/s; used on a grid of 1 s" in text
    assert "column Intake Manifold Pressure(psi)" in text
    assert "missing: fuel_mass_mg" in text
    assert "note: 1 time the clock started again" in text
    assert "its end" not in text
    # a lambda that hardly ever leaves its greatest value is told
    held = np.where(np.arange(300) < 10, READINGS[LAMBDA], 1.34)
    assert cli.main(["check", str(torque(tmp_path / "rail.csv", **{LAMBDA: held}))]) == 0
    assert "97% at 1.34, its end" in capsys.readouterr().out


def test_check_says_what_the_model_lacks(own: Path, tmp_path: Path, capsys: Capture) -> None:
    assert cli.main(["check", str(own)]) == 0
    assert "the model has all its signals" in capsys.readouterr().out
    path = tmp_path / "t.csv"
    path.write_text("time_s,lambda_measured\n0,1\n0.1,1.01\n")
    assert cli.main(["check", str(path)]) == 3
    assert "missing for the model: air_mass_mg, fuel_mass_mg" in capsys.readouterr().out


def test_an_unknown_logger_gets_a_profile_to_edit(tmp_path: Path, capsys: Capture) -> None:
    d = drive(50)
    path = write_text_table(tmp_path / "x.csv", {"Zeit": d["t_s"], "RPM": d["rpm"]})
    assert cli.main(["check", str(path)]) == 2
    assert "--write-profile" in capsys.readouterr().err
    mine = tmp_path / "x.toml"
    assert cli.main(["check", str(path), "--write-profile", str(mine)]) == 0
    assert cli.main(["check", str(path), "--profile", str(mine)]) == 3  # no lambda yet
    out = capsys.readouterr().out
    assert "column RPM" in out
    assert "profile: x, given" in out
    # AND a profile that was edited is overwritten only if that is wanted
    mine.write_text("edited")
    assert cli.main(["check", str(path), "--write-profile", str(mine)]) == 2
    assert "is there already; --force replaces it" in capsys.readouterr().err
    assert mine.read_text() == "edited"
    assert cli.main(["check", str(path), "--write-profile", str(mine), "--force"]) == 0
    assert "RPM" in mine.read_text()


def test_replay_without_a_model_of_the_car_says_what_to_do(tmp_path: Path, capsys: Capture) -> None:
    path = torque(tmp_path / "drive.csv", **READINGS)
    assert cli.main(["replay", str(path)]) == 3
    out = capsys.readouterr().out
    assert ", which this log (torque) lacks; train a model on healthy drives" in out
    flow = {"Mass Air Flow Rate(g/s)": ["0"] * 300, "Fuel Rail Pressure(psi)": ["0"] * 300}
    assert cli.main(["replay", str(torque(tmp_path / "still.csv", **READINGS, **flow))]) == 3
    said = "(column Mass Air Flow Rate(g/s) is blank, or 0 throughout, column Fuel Rail"
    assert said in capsys.readouterr().out
    assert cli.main(["replay", str(torque(tmp_path / "blind.csv"))]) == 2
    assert "lacks; log lambda_measured first" in capsys.readouterr().err
    assert cli.main(["replay", str(path), "--profile", "toque"]) == 2
    assert "no profile toque: a file or one of bluedriver, canonical" in capsys.readouterr().err


def test_parquet_is_judged_where_a_library_is_there_and_says_how_to_get_one(
    own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    polars = pytest.importorskip("polars")
    path = tmp_path / "drive.parquet"
    drive = polars.read_csv(own, infer_schema_length=None)
    drive.select(polars.selectors.numeric()).write_parquet(path)
    assert cli.main(["replay", str(path), "--quiet"]) == 0
    monkeypatch.setitem(sys.modules, "polars", None)
    with pytest.raises(RecordingError, match="pip install polars, or write the table as CSV"):
        read_table(path)


@pytest.mark.parametrize(
    ("running", "reading", "said"),
    [
        (1.0, "2.0", "lambda_measured stands at an end of its range throughout: nothing to learn"),
        (1.0, "-", "no lambda_measured: neither o2train fit nor o2mon replay can use this log"),
        (0.0, None, "the engine never runs in this log by engine_speed_rpm: nothing to learn from"),
        (np.arange(300) >= 200, None, "o2train fit learns a model"),
    ],
)
def test_a_fit_is_recommended_only_where_sensor_and_engine_were_on(
    running: Any, reading: str | None, said: str, tmp_path: Path, capsys: Capture
) -> None:
    made = drive(n=300, period_s=1.0)
    own = [reading] * 300 if reading else made["afr"] / 14.7
    speed = {LAMBDA: own, "Engine RPM(rpm)": running * made["rpm"]}
    cli.main(["check", str(torque(tmp_path / "off.csv", **speed))])
    text = capsys.readouterr().out
    assert text.splitlines()[-1].startswith(said)
    assert ("of the 100 rows in which the engine runs" in text) == ("learns" in said)


def test_a_log_with_the_rear_sensor_alone_is_for_the_catalyst(
    tmp_path: Path, capsys: Capture
) -> None:
    rear = {"O2 Bank 1 Sensor 2 Voltage(V)": ["0.7"] * 300}
    cli.main(["check", str(torque(tmp_path / "rear.csv", **rear))])
    said = "no lambda_measured: o2mon replay judges only the catalyst and the sensor behind it"
    assert said in capsys.readouterr().out


def test_where_the_profile_knows_no_sensor_another_one_is_offered(
    tmp_path: Path, capsys: Capture
) -> None:
    own = {"Front wideband lambda": READINGS[LAMBDA]}
    assert cli.main(["check", str(torque(tmp_path / "own.csv", **own))]) == 3
    said = capsys.readouterr().out.splitlines()[-1]
    assert said.startswith("columns with other names? 'o2mon check")


def test_times_in_ms_without_their_unit_are_pointed_out(tmp_path: Path, capsys: Capture) -> None:
    rows = "\n".join(f"{100 * i},{900 + i},1.0" for i in range(5))
    log = tmp_path / "ms.csv"
    log.write_text(f"time_s,engine_speed_rpm,lambda_measured\n{rows}\n")
    cli.main(["check", str(log)])
    assert "note: a row every 100 s; are the times in ms?" in capsys.readouterr().out


def test_a_check_takes_profile_and_columns_from_the_model(tmp_path: Path, capsys: Capture) -> None:
    log, model = log_and_model(tmp_path, drive(400))
    assert cli.main(["check", str(log)]) == 2
    assert cli.main(["check", str(log), "--model", str(model)]) == 3
    out = capsys.readouterr().out
    assert ", of the model\n" in out
    assert "missing for the model: fuel_mass_mg, " in out  # and not its first input, Luft


def test_a_check_reads_a_table_once(own: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reads, make = list[Path](), tables.make_table

    def counted(path: Path, *parts: Any) -> tables.Table:
        reads.append(path)
        return make(path, *parts)

    monkeypatch.setattr(tables, "make_table", counted)
    assert cli.main(["check", str(own)]) == 0
    assert reads == [own]


@pytest.mark.parametrize("each_s", [4, 12, 30])
def test_a_sensor_that_a_logger_rarely_asks_for_is_not_stuck(
    each_s: int, tmp_path: Path, capsys: Capture
) -> None:
    # GIVEN a log with a row a second, in which a sound lambda comes every few seconds
    own = drive(900, period_s=1.0)
    asked = [f"{x:.2f}" if k % each_s == 0 else "" for k, x in enumerate(own["afr"])]
    cells = {"Uhr": own["t_s"], "U/min": own["rpm"], "MAP": own["map_kpa"], "Sonde": asked}
    log, profile = write_text_table(tmp_path / "drive.csv", cells), tmp_path / "own.toml"
    profile.write_text(
        'time = "Uhr"\n[signals]\nengine_speed_rpm = "U/min"\nmanifold_pressure_kpa = "MAP"\n'
        'lambda_measured = { column = "Sonde", unit = "AFR" }\n'
    )
    # WHEN it is replayed THEN the held reading is no sensor that stands still
    assert cli.main(["replay", str(log), "--profile", str(profile)]) == 3
    assert "stuck" not in capsys.readouterr().out
