"""Columns in memory, by name, as a table."""

from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.errors import RecordingError
from monitor.grid.tables import TIME, Table, make_table

_TIMES = (TIME, "time", "timestamp")


def table_of(columns: Any, name: str) -> Table:
    """Return columns of equal length, ``time_s`` among them, as a table.

    columns : dict of arrays, or a frame of polars or pandas; masked values are blank. The time may
        also be called Time or Timestamp, and be dates
    name : of the table in messages
    Raises RecordingError if there is no ``time_s``, or a column is not one of numbers.
    """
    path = Path(name)
    if not hasattr(columns, "__getitem__") or isinstance(columns, str | bytes):
        raise RecordingError(f"{path}: {type(columns).__name__}, columns by name are wanted")
    keys = {str(each): each for each in getattr(columns, "columns", columns)}
    time = next((each for known in _TIMES for each in keys if each.casefold() == known), None)
    if time is None:
        raise RecordingError(f"{path}: no column {TIME}, there are {', '.join(keys)}")
    names = sorted(keys, key=lambda each: each != time)
    arrays = []
    for each in names:
        try:
            column = columns[keys[each]]
            if each == time and np.asarray(column).dtype.kind == "M":
                column = (np.asarray(column) - np.datetime64(0, "us")) / np.timedelta64(1, "s")
            if np.asarray(column).dtype.kind in "cmM":  # complex, or times of any unit
                raise TypeError
            mask = np.ma.getmaskarray(column) if isinstance(column, np.ma.MaskedArray) else False
            arrays.append(np.where(mask, np.nan, np.asarray(column, dtype=np.float64)))
        except (TypeError, ValueError, OverflowError):
            raise RecordingError(f"{path}: column {each}: numbers are wanted") from None
    if any(array.ndim != 1 or len(array) != len(arrays[0]) for array in arrays):
        raise RecordingError(f"{path}: columns of one length and one dimension are wanted")
    return make_table(path, [TIME, *names[1:]], np.column_stack(arrays), None)
