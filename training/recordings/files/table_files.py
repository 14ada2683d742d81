"""Tables on disk: CSV, gzipped CSV and Parquet; the same table gives the same bytes."""

import gzip
import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Final, cast

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.files.outputs import MARK, replaced
from monitor.base.types import FloatArray
from monitor.grid.tables import TIME

GENERATOR: Final = {"generator": f'"{MARK}"'}  # metadata of a Parquet file
SUFFIXES = (".csv", ".csv.gz", ".parquet")


def write_table(
    path: str | Path, t_s: FloatArray, names: Sequence[str], values: FloatArray
) -> None:
    """Write a table; the format follows from the suffix .csv, .csv.gz or .parquet.

    t_s : (n,) times in seconds, written in microseconds
    names : of the columns
    values : (n, n_names); NaN becomes a blank cell
    Raises RecordingError if the format is unknown, UsageError if the file cannot be written.
    """
    import polars as pl  # noqa: PLC0415

    path = Path(path)
    if not path.name.lower().endswith(SUFFIXES):
        raise RecordingError(f"{path}: unknown table format, known are {' '.join(SUFFIXES)}")
    frame = pl.DataFrame(
        {TIME: np.rint(t_s * 1e6) / 1e6}
        | {name: np.ascontiguousarray(values[:, i]) for i, name in enumerate(names)}
    ).with_columns(pl.all().fill_nan(None))
    buffer = io.BytesIO()
    if path.suffix.lower() == ".parquet":
        frame.write_parquet(buffer, metadata=GENERATOR)
    else:
        frame.write_csv(buffer)
    with replaced(path) as begun, open_for_writing(begun) as file:
        file.write(buffer.getvalue())


@contextmanager
def open_for_writing(path: Path) -> Iterator[IO[bytes]]:
    """Open ``path`` for writing, compressed if it ends in .gz, without name or time inside."""
    with path.open("wb") as file:
        if path.suffix.lower() != ".gz":
            yield file
            return
        with gzip.GzipFile(filename="", mode="wb", fileobj=file, mtime=0) as packed:
            yield cast(IO[bytes], packed)
