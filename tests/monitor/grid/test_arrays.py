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
    table = table_of({"time_s": T_S, "speed": column}, "arrays")
    assert np.isnan(table.values[:, 0]).tolist() == [False, True, False, False]
