"""Everyday imperfections of a healthy drive's table set no code."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor import cli
from monitor.base.signals import plausible_range
from monitor.base.types import FloatArray
from monitor.grid.column_times import column_times, merged, unlike
from training.recordings.recording import load

DRIVE = Path(__file__).resolve().parents[3] / "replay_logs" / "healthy_micro_trips_v102_s102.blf"
Change = Callable[[FloatArray], FloatArray]
NAMES = load(DRIVE).names


def held(rows: int) -> Change:
    return lambda values: values[np.arange(len(values)) // rows * rows]


def late(rows: int) -> Change:
    return lambda values: np.concatenate([values[:rows], values[:-rows]])


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


def passed_windows(told: str) -> int:
    found = re.search(r"windows: (\d+) passed, 0 failed", told)
    assert found, told
    return int(found[1])


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
    assert passed_windows(told) >= 27  # of the 29 of the whole table
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


@pytest.mark.parametrize(
    ("names", "change", "told"),
    [
        (("lambda_measured",), held(10), "lambda_measured changes every 1 s, the model needs it"),
        (("fuel_mass_mg",), held(3), "fuel_mass_mg changes every 0.3 s, the model needs it"),
        (("fuel_mass_mg", "air_mass_mg"), late(1), "s later against manifold_pressure_kpa than in"),
    ],
)
def test_columns_that_the_logger_writes_at_other_times_are_named_and_no_response_is_judged(
    names: tuple[str, ...],
    change: Change,
    told: str,
    written: Callable[..., Path],
    capsys: pytest.CaptureFixture[str],
) -> None:
    def other_times(values: FloatArray, _: int) -> None:
        for place in [NAMES.index(name) for name in names]:
            values[:, place] = change(values[:, place])

    assert cli.main(["replay", str(written(other_times))]) == 3
    said = capsys.readouterr().out
    assert "not judged: response: " in said
    assert told in said


def test_an_input_far_outside_of_the_model_s_training_is_named(
    written: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    def hotter(values: FloatArray, _: int) -> None:
        values[:, NAMES.index("manifold_temperature_degc")] += 40.0

    assert cli.main(["replay", str(written(hotter))]) == 3
    said = capsys.readouterr().out
    assert "not judged: trained range held " in said
    assert "manifold_temperature_degc is above " in said


def test_an_air_flow_in_g_s_is_refused_because_no_engine_has_one_cylinder_and_a_tenth(
    written: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    def in_g_s(values: FloatArray, _: int) -> None:
        values[:, NAMES.index("maf_kg_h")] /= 3.6

    assert cli.main(["replay", str(written(in_g_s))]) == 2
    assert "are those of 1.1 cylinders" in capsys.readouterr().err


def test_readings_that_jump_to_the_end_of_the_range_now_and_then_make_no_offset(
    written: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    def spikes(values: FloatArray, reading: int) -> None:
        hit = np.random.default_rng(1).random(len(values)) < 0.01
        values[hit, reading] = plausible_range("lambda_measured")[1]

    assert cli.main(["replay", str(written(spikes))]) == 0
    assert passed_windows(capsys.readouterr().out) >= 27  # of the 29 of the whole table


def test_what_is_usual_for_a_logger_is_no_other_time() -> None:
    # GIVEN a logger that writes a slow column each second and the second one 0.2 s late
    fast = np.cumsum(np.random.default_rng(2).normal(size=2000))
    values = np.column_stack([fast, late(2)(fast), held(10)(fast)])
    own = column_times(values, ("a", "b", "c"), 0.1)
    known = merged([own], {"a", "b"})
    # WHEN its next log comes THEN nothing is told; a column more or less late is
    assert unlike(known, values, ("a", "b", "c"), 0.1) == ""
    values[:, 1] = late(3)(fast)
    assert unlike(known, values, ("a", "b", "c"), 0.1) == (
        "b comes 0.1 s later against a than in the recordings that trained the model"
    )


@given(
    step=st.sampled_from([1e-6, 0.01, 0.1]),
    rows=st.integers(1, 8),
    seed=st.integers(0, 1000),
)
def test_a_column_s_interval_is_how_often_it_is_written_not_how_coarse(
    step: float, rows: int, seed: int
) -> None:
    moving = np.cumsum(np.random.default_rng(seed).normal(size=3000))
    values = held(rows)(np.round(moving / step) * step)
    every_s = column_times(values[:, np.newaxis], ("a",), 0.1)["every_s"]["a"]
    assert every_s == pytest.approx(0.1 * rows)
