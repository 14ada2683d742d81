"""Columns that are no numbers are one clear line; masked values are blank."""

from typing import Any

import numpy as np
import pytest

from monitor.base.errors import RecordingError
from monitor.grid.arrays import table_of

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
