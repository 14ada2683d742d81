"""Parquet tables, through polars or pyarrow where one of them is installed."""

from collections.abc import Collection
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.files.inputs import open_regular
from monitor.base.types import FloatArray


def read_parquet(path: Path, needed: Collection[str] | None) -> tuple[list[str], FloatArray]:
    """Return names and cells, (n, n_columns), of the columns with numbers; null is NaN.

    needed : columns that must hold numbers, None for all of them
    Raises RecordingError if the file cannot be read, or neither library is installed.
    """
    columns = _columns(path)
    for name, values in columns.items():
        if values is None and (needed is None or name in needed):
            raise RecordingError(f"{path}: column {name} holds no numbers, numbers are wanted")
    numbers = {name: values for name, values in columns.items() if values is not None}
    cells = np.column_stack(list(numbers.values())) if numbers else np.empty((0, 0))
    return list(numbers), cells


def _columns(path: Path) -> dict[str, FloatArray | None]:
    """Return the columns, None for one that holds no numbers."""
    library = next((name for name in ("polars", "pyarrow") if find_spec(name)), None)
    if library is None:
        raise RecordingError(
            f"{path}: reading Parquet needs polars or pyarrow: pip install polars, or write the "
            f"table as CSV: o2train table {path.name} --out {path.with_suffix('.csv').name}"
        )
    try:
        with open_regular(path) as file:
            if library == "polars":
                return _through_polars(import_module("polars"), file)
            return _through_pyarrow(import_module("pyarrow.parquet"), file)
    except Exception as error:  # of libraries that have no common base for their errors
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RecordingError(f"{path}: cannot read the table: {reason}") from error


def _through_polars(polars: ModuleType, file: Any) -> dict[str, FloatArray | None]:
    try:
        frame = polars.read_parquet(file)
    except polars.exceptions.PanicException as panic:  # of a damaged file; no Exception
        raise ValueError("damaged") from panic
    return {
        name: series.cast(polars.Float64).fill_null(float("nan")).to_numpy()
        if series.dtype.is_numeric() or series.dtype == polars.Boolean
        else None
        for name, series in zip(frame.columns, frame.iter_columns(), strict=True)
    }


def _through_pyarrow(parquet: ModuleType, file: Any) -> dict[str, FloatArray | None]:
    table = parquet.read_table(file)
    return {
        field.name: np.array(
            [np.nan if value is None else value for value in column.to_pylist()], dtype=np.float64
        )
        if str(field.type).startswith(("int", "uint", "float", "double", "half", "bool"))
        else None
        for field, column in zip(table.schema, table.columns, strict=True)
    }
