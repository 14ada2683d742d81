"""Everyday imperfections of a healthy drive's table set no code."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from monitor import cli
from monitor.base.types import FloatArray
from training.recordings.recording import load

DRIVE = Path(__file__).resolve().parents[3] / "replay_logs" / "healthy_micro_trips_v102_s102.blf"
Change = Callable[[FloatArray], FloatArray]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    recording = load(DRIVE)
    names = recording.names

    def write(change: Callable[[FloatArray, int], None]) -> Path:
        values = recording.values.copy()
        change(values, names.index("lambda_measured"))
        t_s = np.arange(len(values)) * recording.period_ns / 1e9
        path = tmp_path_factory.mktemp("drive") / "drive.csv"
        header = ",".join(("time_s", *names))
        np.savetxt(path, np.column_stack([t_s, values]), "%.9g", ",", header=header, comments="")
        return path

    return write


def test_one_blank_cell_in_a_hundred_is_filled_and_counted_and_the_drive_is_judged(
    written: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    n_blank = 0

    def blanks(values: FloatArray, _: int) -> None:
        nonlocal n_blank
        hit = np.random.default_rng(1).random(values.shape) < 0.01
        hit[:300] = False
        n_blank = int((hit & ~np.isnan(values)).sum())
        values[hit] = np.nan

    assert cli.main(["replay", str(written(blanks))]) == 0
    told = capsys.readouterr().out
    assert "windows: 29 passed" in told  # as of the whole table
    assert f"{n_blank} blank cells filled with the value before it" in told


def test_a_reading_left_blank_for_three_seconds_is_a_gap_of_the_log(
    written: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    def blank(values: FloatArray, reading: int) -> None:
        values[2000:2030, reading] = np.nan

    assert cli.main(["replay", str(written(blank))]) == 0
    assert "U0401" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda reading: reading * 14.7, "is an air-fuel ratio"),
        (lambda reading: 1.0 / reading, "where fuel is cut: 1/lambda as lambda_measured"),
    ],
    ids=["AFR", "1/lambda"],
)
def test_another_quantity_in_lambda_s_column_is_told_in_one_line_and_not_judged(
    change: Change, told: str, written: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    def other(values: FloatArray, reading: int) -> None:
        values[:, reading] = change(values[:, reading])

    assert cli.main(["replay", str(written(other))]) == 2
    out, line = capsys.readouterr()
    assert told in line
    assert line.count("\n") == 1
    assert "P2" not in out


def test_a_reading_that_is_polled_each_half_second_is_told(
    written: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    def poll(values: FloatArray, reading: int) -> None:
        values[:, reading] = values[np.arange(len(values)) // 5 * 5, reading]

    cli.main(["replay", str(written(poll))])
    told = "lambda_measured changes every 0.5 s, rows come every 0.1 s: polled or held"
    assert told in capsys.readouterr().out
    cli.main(["replay", str(written(lambda *_: None))])
    assert "polled" not in capsys.readouterr().out
