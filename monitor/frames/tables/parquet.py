"""Parquet tables, through polars."""

import os
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.files.inputs import open_regular
from monitor.base.types import FloatArray
from monitor.frames.tables.readers import reason


def read_parquet(path: Path, needed: Collection[str] | None) -> tuple[list[str], FloatArray]:
    """Return names and cells, (n, n_columns), of the columns with numbers; null is NaN.

    needed : columns that must hold numbers, None for all of them
    Raises RecordingError if the file cannot be read, or polars is not installed.
    """
    columns = _columns(path)
    for name, values in columns.items():
        if values is None and (needed is None or name in needed):
            raise RecordingError(f"{path}: column {name} holds no numbers, numbers are wanted")
    numbers = {name: values for name, values in columns.items() if values is not None}
    cells = np.column_stack(list(numbers.values())) if numbers else np.empty((0, 0))
    return list(numbers), cells


@contextmanager
def _silent() -> Iterator[None]:
    """Keep from stderr what polars' compiled code prints of a damaged file beside its error."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _columns(path: Path) -> dict[str, FloatArray | None]:
    """Return the columns, None for one that holds no numbers."""
    try:
        polars = import_module("polars")
    except ImportError as error:
        raise RecordingError(
            f"{path}: reading Parquet needs polars: pip install polars, or write the "
            f"table as CSV: o2train table {path.name} --out {path.with_suffix('.csv').name}"
        ) from error
    try:
        with open_regular(path) as file, _silent():
            frame = polars.read_parquet(file)
        return {
            name: series.cast(polars.Float64).fill_null(float("nan")).to_numpy()
            if series.dtype.is_numeric() or series.dtype == polars.Boolean
            else None
            for name, series in zip(frame.columns, frame.iter_columns(), strict=True)
        }
    except polars.exceptions.PanicException as panic:  # of a damaged file; no Exception
        raise RecordingError(f"{path}: cannot read the table: damaged") from panic
    except Exception as error:  # polars has no common base for its errors
        raise RecordingError(f"{path}: cannot read the table: {reason(error)}") from error
