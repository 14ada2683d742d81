"""Everyday imperfections of a healthy drive's table set no code."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor import cli
from monitor.base.errors import RecordingError
from monitor.base.signals import plausible_range
from monitor.base.types import FloatArray
from monitor.grid.arrays import table_of
from monitor.grid.column_times import column_times, unlike
from tests.helpers.drives.drive_tables import Columns, table
from tests.helpers.logs.replays import replays
from training.healthy.new_model import merged

Change = Callable[[FloatArray], FloatArray]
Replay = Callable[[Callable[[Columns], None]], tuple[int, str, str]]


def held(rows: int) -> Change:
    return lambda values: values[np.arange(len(values)) // rows * rows]


def late(rows: int) -> Change:
    return lambda values: np.concatenate([values[:rows], values[:-rows]])


@pytest.fixture
def replay(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Replay:
    """Give a replay of the changed table: exit code, what was said, and errors."""

    def run(change: Callable[[Columns], None]) -> tuple[int, str, str]:
        code = cli.main(["replay", str(table(tmp_path / "drive.csv", change))])
        return code, *capsys.readouterr()

    return run


def blank(data: Columns) -> None:
    data["lambda_measured"][2000:2030] = np.nan


def spikes(data: Columns) -> None:
    hit = np.random.default_rng(1).random(len(data["lambda_measured"])) < 0.01
    data["lambda_measured"][hit] = plausible_range("lambda_measured")[1]


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(blank, id="a reading left blank for three seconds is a gap of the log"),
        pytest.param(spikes, id="jumps to the end of the range now and then make no offset"),
    ],
)
def test_a_reading_that_is_blank_or_jumps_for_a_moment_sets_no_code(
    change: Callable[[Columns], None], replay: Replay
) -> None:
    code, told, _ = replay(change)
    assert code == 0
    assert passed_windows(told) >= 26  # of the 29 of the whole table


def passed_windows(told: str) -> int:
    found = re.search(r"windows: (\d+) passed, 0 failed", told)
    assert found, told
    return int(found[1])


def test_one_blank_cell_in_a_hundred_is_filled_and_counted(replay: Replay) -> None:
    n_blank, rng = 0, np.random.default_rng(1)

    def blanks(data: Columns) -> None:
        nonlocal n_blank
        for values in list(data.values())[1:]:
            hit = rng.random(len(values)) < 0.01
            hit[:300] = False
            n_blank += int((hit & ~np.isnan(values)).sum())
            values[hit] = np.nan

    code, told, _ = replay(blanks)
    assert code == 0
    assert passed_windows(told) >= 27  # of the 29 of the whole table
    assert f"{n_blank} blank cells filled with the value before it" in told


@pytest.mark.parametrize("pause_s", [0.9, 12.0])
def test_a_drive_with_a_pause_of_the_logger_gets_no_code(pause_s: float, tmp_path: Path) -> None:
    def pause(data: Columns) -> None:
        data["time_s"][2000:] += pause_s

    code, (judged,) = replays(table(tmp_path / "paused.csv", pause))
    assert (code, judged["dtcs"]) == (0, [])
    assert judged["windows_interrupted"] >= 1


@pytest.mark.parametrize("every", [2, 10])
def test_rows_further_apart_than_samples_are_not_judged(every: int, replay: Replay) -> None:
    def coarse(data: Columns) -> None:
        data.update({name: values[::every] for name, values in data.items()})

    code, told, _ = replay(coarse)
    assert code == 3
    assert f"samples every {every / 10:g} s, the model needs them every 0.1 s" in told


@pytest.mark.parametrize(
    ("name", "change", "told"),
    [
        ("lambda_measured", lambda reading: reading * 14.7, "is an air-fuel ratio"),
        ("lambda_measured", lambda x: 1.0 / x, "where fuel is cut: 1/lambda as lambda_measured"),
        ("maf_kg_h", lambda flow: flow / 3.6, "are those of 1.1 cylinders"),
    ],
    ids=["AFR", "1/lambda", "an air flow in g/s is that of an engine of one cylinder and a tenth"],
)
def test_another_quantity_in_a_column_is_told_in_one_line_and_not_judged(
    name: str, change: Change, told: str, replay: Replay
) -> None:
    code, out, line = replay(lambda data: data.update({name: change(data[name])}))
    assert code == 2
    assert told in line
    assert line.count("\n") == 1
    assert "P2" not in out


@pytest.mark.parametrize(
    ("names", "change", "told"),
    [
        (("lambda_measured",), held(10), "lambda_measured changes every 1 s, the model needs it"),
        (("fuel_mass_mg",), held(3), "fuel_mass_mg changes every 0.3 s, the model needs it"),
        (("fuel_mass_mg", "air_mass_mg"), late(1), "s later against manifold_pressure_kpa than in"),
        (("manifold_temperature_degc",), lambda x: x + 40.0, "manifold_temperature_degc is above "),
    ],
    ids=["a slow reading", "a slow input", "late inputs", "an input far outside of the training"],
)
def test_columns_written_at_other_times_or_untrained_are_named_and_no_response_is_judged(
    names: tuple[str, ...], change: Change, told: str, replay: Replay
) -> None:
    code, said, _ = replay(lambda data: data.update({n: change(data[n]) for n in names}))
    assert code == 3
    assert re.search("not judged: (response:|the inputs are in the trained range for )", said)
    assert told in said


def test_what_is_usual_for_a_logger_is_no_other_time() -> None:
    # GIVEN a logger that writes a slow column each second and the second one 0.2 s late
    fast = np.cumsum(np.random.default_rng(2).normal(size=2000))
    values = np.column_stack([fast, late(2)(fast), held(10)(fast)])
    names = ("a", "boost kPa", "c")
    own = column_times(values, names, 0.1)
    known = merged([own], set(names[:2]))
    # WHEN its next log comes THEN nothing is told; a column more or less late is
    assert unlike(known, values, names, 0.1) == ""
    values[:, 1] = late(3)(fast)
    assert unlike(known, values, names, 0.1) == (
        "boost kPa comes 0.1 s later against a than in the recordings that trained the model"
    )


@given(step=st.sampled_from([1e-6, 0.01, 0.1]), rows=st.integers(1, 8), seed=st.integers(0, 1000))
def test_a_column_s_interval_is_how_often_it_is_written(step: float, rows: int, seed: int) -> None:
    moving = np.cumsum(np.random.default_rng(seed).normal(size=3000))
    values = held(rows)(np.round(moving / step) * step)
    every_s = column_times(values[:, np.newaxis], ("a",), 0.1)["every_s"]["a"]
    assert every_s == pytest.approx(0.1 * rows)


T_S = np.arange(4) / 10.0


@pytest.mark.parametrize(
    "column",
    [T_S * 1j, (T_S * 1000.0).astype("datetime64[ms]"), [10**400] * 4, [object()] * 4],
    ids=["complex", "dates", "400 digits", "objects"],
)
def test_what_is_no_number_is_refused_by_the_column_s_name(column: Any) -> None:
    with pytest.raises(RecordingError, match="column speed: numbers are wanted"):
        table_of({"time_s": T_S, "speed": column}, "arrays")


@pytest.mark.parametrize("columns", [None, 5, b"drive", "drive"])
def test_what_has_no_columns_is_refused(columns: Any) -> None:
    with pytest.raises(RecordingError, match="columns by name are wanted"):
        table_of(columns, "arrays")


def test_a_masked_value_is_blank() -> None:
    column = np.ma.MaskedArray([1.0, 2.0, 3.0, 4.0], [False, True, False, False])
    table = table_of({"Time": T_S + 9.0, "time_s": T_S, 7: column}, "arrays")
    assert (table.names, table.t_ns[0]) == (("Time", "7"), round(T_S[0] * 1e9))
    assert np.isnan(table.values[:, 1]).tolist() == [False, True, False, False]


@pytest.mark.parametrize("name", ["Time", "timestamp", "time_s"])
def test_dates_are_times_in_any_unit(name: str) -> None:
    dates = np.datetime64("2026-01-02T03:04:05", "ms") + (T_S * 1000.0).astype("timedelta64[ms]")
    table = table_of({"speed": T_S, name: dates}, "arrays")
    assert table.names == ("speed",)
    assert (table.t_ns - table.t_ns[0]).tolist() == [0, 100_000_000, 200_000_000, 300_000_000]


def test_a_date_that_is_missing_is_refused() -> None:
    dates = np.array(["2026-01-02", "NaT"], dtype="datetime64[s]")
    with pytest.raises(RecordingError, match="time_s is not a number"):
        table_of({"Time": dates, "speed": T_S[:2]}, "arrays")
