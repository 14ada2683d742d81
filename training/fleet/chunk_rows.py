"""Result of a chunk: its rows as parquet files and its cost, sent back by the worker."""

import io
import time
from collections.abc import Sequence
from dataclasses import dataclass

import polars as pl

from training.fleet import columns
from training.fleet.drives import FleetDrive
from training.fleet.rows import Row, failed_row


@dataclass(frozen=True, slots=True)
class Done:
    """Rows of a chunk as parquet files, and the cost of the chunk."""

    recordings: bytes  # parquet file, one row per recording
    windows: bytes  # parquet file, one row per window
    drives: int
    errors: int  # drives that could not be judged
    faults: int  # drives with a code
    seconds: dict[str, float]  # processor time by step: read, judge, rows
    driving_s: float
    size_bytes: int  # of the recordings


def failed(drives: Sequence[FleetDrive], reason: str) -> Done:
    """Return the result for drives that all failed for the same reason."""
    return of_rows([failed_row(drive, f"{drive.path}: {reason}") for drive in drives], [], {})


def joined(parts: Sequence[Done]) -> Done:
    """Return several results as one."""
    steps = dict.fromkeys(step for part in parts for step in part.seconds)
    summed = ("drives", "errors", "faults", "driving_s", "size_bytes")
    return Done(
        recordings=_concatenated([part.recordings for part in parts]),
        windows=_concatenated([part.windows for part in parts]),
        seconds={step: sum(part.seconds.get(step, 0.0) for part in parts) for step in steps},
        **{name: sum(getattr(part, name) for part in parts) for name in summed},
    )


def of_rows(rows: Sequence[Row], windows: Sequence[Row], seconds: dict[str, float]) -> Done:
    """Return the result of a chunk from its rows.

    seconds : processor time by step; the time to make the tables is added as the step ``rows``
    """
    began_s = time.process_time()
    tables = [
        _parquet(pl.DataFrame([*map(_encodable, content)], schema=columns.schema(wanted)))
        for content, wanted in ((rows, columns.RECORDINGS), (windows, columns.WINDOWS))
    ]
    return Done(
        recordings=tables[0],
        windows=tables[1],
        drives=len(rows),
        errors=sum(row.get("error") is not None for row in rows),
        faults=sum(bool(row.get("fault_flag")) for row in rows),
        seconds=seconds | {"rows": time.process_time() - began_s},
        driving_s=sum(row.get("duration_s") or 0.0 for row in rows),
        size_bytes=sum(row.get("size_bytes") or 0 for row in rows),
    )


def _concatenated(parts: Sequence[bytes]) -> bytes:
    return _parquet(pl.concat(pl.read_parquet(io.BytesIO(part)) for part in parts))


def _encodable(row: Row) -> Row:
    """Return a row whose texts show bytes of file names that are not UTF-8 as escapes."""
    texts = {key: value for key, value in row.items() if isinstance(value, str)}
    return row | {k: text.encode("utf-8", "backslashreplace").decode() for k, text in texts.items()}


def _parquet(table: pl.DataFrame) -> bytes:
    buffer = io.BytesIO()
    table.write_parquet(buffer)
    return buffer.getvalue()
