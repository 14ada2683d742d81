"""Faults put into the lambda of tables and loggers' files."""

from pathlib import Path

import numpy as np
import pytest

from monitor import cli
from monitor.grid.tables import read_table
from tests.helpers.drives.drive_tables import table
from tests.helpers.logs.car_model import log_and_model
from tests.helpers.logs.logger_files import drive, write_text_table


def columns(path: Path) -> dict[str, np.ndarray]:
    read = read_table(path)
    return dict(zip(read.names, read.values.T, strict=True))


def test_a_table_with_a_late_sensor_has_the_code_of_a_late_sensor(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # GIVEN a healthy table, and a scenario whose sensor is late from 60 s on
    healthy, late = table(tmp_path / "drive.csv"), tmp_path / "late.csv"
    scenario = tmp_path / "late.toml"
    scenario.write_text(
        '[[fault]]\nname = "delay_rich_to_lean"\nstart_s = 60.0\n'
        '[[expect]]\ncode = "P015A"\nwithin_s = 120.0\n'
    )
    # WHEN it is put on and judged at once
    given = ("inject", str(healthy), "--scenario", str(scenario))
    assert cli.main([*given, "--assert", "--out", str(late)]) == 0
    assert "P015A pending (delay_rich_to_lean)" in capsys.readouterr().out
    # THEN the written table has the same verdict, and only lambda differs, from 60 s on
    assert cli.main(["replay", str(late)]) == 1
    assert "P015A delay_rich_to_lean" in capsys.readouterr().out
    before, after = columns(healthy), columns(late)
    for name, values in before.items():
        same = np.isclose(values, after[name], rtol=1e-6, equal_nan=True)
        assert same[: 600 if name == "lambda_measured" else None].all(), name
    assert not np.isclose(before["lambda_measured"], after["lambda_measured"])[600:].all()


def test_a_logger_s_file_becomes_a_table_whose_pinned_readings_stay(tmp_path: Path) -> None:
    own = drive(400)
    own["afr"][:50] = 22.3  # the controller's value for a cold sensor
    cells = {"Time": own["t_s"], "RPM": own["rpm"], "AFR": own["afr"]}
    log = write_text_table(tmp_path / "drive.csv", cells)
    profile = tmp_path / "own.toml"
    profile.write_text(
        'time = "Time"\n[signals]\nengine_speed_rpm = "RPM"\n'
        'lambda_measured = { column = "AFR", unit = "AFR", pinned = [22.3] }\n'
    )
    out = tmp_path / "out.csv"
    more = ("--profile", str(profile), "--fault", "biased_lean=0.1")
    assert cli.main(["inject", str(log), "--out", str(out), *more]) == 0
    moved = columns(out)["lambda_measured"] - own["afr"] / 14.7
    assert moved[:50] == pytest.approx(np.zeros(50), abs=1e-6)
    assert moved[50:] == pytest.approx(np.full(350, 0.1), abs=1e-4)


def test_a_sensor_that_is_not_ready_leaves_blanks_and_says_so(tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    healthy = table(tmp_path / "drive.csv")
    assert (
        cli.main(["inject", str(healthy), "--out", str(out), "--fault", "not_ready@100-110"]) == 0
    )
    after = columns(out)
    blank = np.isnan(after["lambda_measured"]) & ~np.isnan(columns(healthy)["lambda_measured"])
    assert (np.flatnonzero(blank) == np.arange(1000, 1100)).all()
    assert (after["sensor_ready"][1000:1100] == 0.0).all()


def test_a_fault_is_put_on_a_log_that_only_the_model_of_its_car_knows(tmp_path: Path) -> None:
    # GIVEN a log of a car whose model reads a column without a canonical name
    own = drive(400)
    log, model = log_and_model(tmp_path, own)
    out = tmp_path / "out.csv"
    given = ("inject", str(log), "--out", str(out), "--fault", "biased_lean=0.1")
    assert cli.main(given) == 2
    assert cli.main([*given, "--model", str(model)]) == 0
    # THEN the table has lambda with the fault, and the model's own column
    assert columns(out)["lambda_measured"] == pytest.approx(own["afr"] / 14.7 + 0.1, abs=1e-4)
    assert columns(out)["Luft"] == pytest.approx(own["map_kpa"], abs=1e-4)


def test_a_column_whose_name_has_a_comma_stays_one_column(tmp_path: Path) -> None:
    log, out = tmp_path / "drive.csv", tmp_path / "out.csv"
    log.write_text('time_s,lambda_measured,"boost, kPa"\n0.0,1.0,2.0\n0.1,,3.0\n0.2,1.1,4.0\n')
    assert cli.main(["inject", str(log), "--out", str(out), "--fault", "biased_lean=0.1"]) == 0
    after = columns(out)
    assert after["boost, kPa"].tolist() == [2.0, 3.0, 4.0]
    assert after["lambda_measured"] == pytest.approx([1.1, np.nan, 1.2], nan_ok=True)


@pytest.mark.parametrize(
    ("name", "out", "message"),
    [
        ("frame_loss", "out.csv", "frame_loss is a fault of frames, this is a table"),
        ("signal_missing", "out.csv", "signal_missing is a fault of frames, this is a table"),
        ("signal_invalid", "out.csv", "signal_invalid is a fault of frames, this is a table"),
        ("gain_low=0.5@9999", "out.csv", "gain_low=0.5 from 9999 s: begins after the drive's end"),
        ("gain_low", "out.log", "out.log: a changed table is written as .csv"),
        ("gain_low", "drive.csv", "is read, too; choose another file to write"),
    ],
)
def test_what_a_table_cannot_have_is_refused(
    name: str, out: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    healthy = str(table(tmp_path / "drive.csv"))
    assert cli.main(["inject", healthy, "--out", str(tmp_path / out), "--fault", name]) == 2
    assert message in capsys.readouterr().err
