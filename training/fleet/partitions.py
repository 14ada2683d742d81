"""The tables of a fleet as folders per vehicle and date, as query engines read them.

The layout is Hive's: ``recordings/vehicle=17/date=2026-03-01/*.parquet``. DuckDB, polars, Spark and
others read both keys from the folders' names, and only the folders that a query asks for.
"""

import shutil
from pathlib import Path
from typing import Final

import polars as pl

from monitor.base.errors import UsageError

KEYS: Final = ("vehicle", "date")


def check(folder: Path) -> None:
    """Raise UsageError if the folder holds something: old and new results must not mix."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(f"--partitioned {folder}: an empty or new folder is wanted")


def write(recordings: Path, windows: Path, folder: Path, begun: Path) -> None:
    """Write both tables of a run as folders; a recording without a date has none in its folder.

    recordings, windows : tables of the run, .parquet
    begun : in the run's own folder; takes the place of ``folder`` when it is whole
    Raises UsageError if the folder cannot be written.
    """
    drives = pl.scan_parquet(recordings).with_columns(pl.col("start").dt.date().alias("date"))
    days = drives.select("recording", "date")
    tables = {
        "recordings": drives,
        "windows": pl.scan_parquet(windows).join(days, on="recording", how="left"),
    }
    shutil.rmtree(begun, ignore_errors=True)  # of a killed run
    try:
        for name, table in tables.items():
            place = pl.PartitionBy(begun / name, key=list(KEYS), include_key=False)
            table.sink_parquet(place, mkdir=True)
        if folder.exists():
            folder.rmdir()
        shutil.move(begun, folder)  # it may lie on another disk
    except (OSError, pl.exceptions.ComputeError) as error:
        raise UsageError(f"--partitioned {folder}: {error}") from error
