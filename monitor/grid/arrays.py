"""Columns in memory, by name, as a table."""

from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.errors import RecordingError
from monitor.grid.tables import TIME, Table, make_table


def table_of(columns: Any, name: str) -> Table:
    """Return columns of equal length, ``time_s`` among them, as a table.

    columns : dict of arrays, or a frame of polars or pandas; masked values are blank
    name : of the table in messages
    Raises RecordingError if there is no ``time_s``, or a column is not one of numbers.
    """
    path = Path(name)
    if not hasattr(columns, "__getitem__") or isinstance(columns, str | bytes):
        raise RecordingError(f"{path}: {type(columns).__name__}, columns by name are wanted")
    names = [str(each) for each in getattr(columns, "columns", columns)]
    if TIME not in names:
        raise RecordingError(f"{path}: no column {TIME}, there are {', '.join(names)}")
    names.sort(key=lambda each: each != TIME)
    arrays = []
    for each in names:
        try:
            column = columns[each]
            if np.asarray(column).dtype.kind in "cmM":  # complex, or times of any unit
                raise TypeError
            mask = np.ma.getmaskarray(column) if isinstance(column, np.ma.MaskedArray) else False
            arrays.append(np.where(mask, np.nan, np.asarray(column, dtype=np.float64)))
        except (TypeError, ValueError, OverflowError):
            raise RecordingError(f"{path}: column {each}: numbers are wanted") from None
    if any(array.ndim != 1 or len(array) != len(arrays[0]) for array in arrays):
        raise RecordingError(f"{path}: columns of one length and one dimension are wanted")
    return make_table(path, names, np.column_stack(arrays), None)
