"""Result of a chunk: the rows of its tables and its cost, sent back by the worker."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import polars as pl

from training.fleet import columns
from training.fleet.drives import FleetDrive
from training.fleet.rows import Row, failed_row


@dataclass(frozen=True, slots=True)
class Done:
    """Rows of a chunk, one per recording and one per window."""

    recordings: pl.DataFrame
    windows: pl.DataFrame
    seconds: dict[str, float]  # processor time by step: read, judge, rows

    @property
    def cost(self) -> dict[str, Any]:
        """Return drives, those with an error and with a code, times, bytes of the recordings."""
        rows = self.recordings
        return {
            "drives": len(rows),
            "errors": int(rows["error"].is_not_null().sum()),
            "faults": int(rows["fault_flag"].sum()),
            "seconds": self.seconds,
            "driving_s": sum(rows["duration_s"].drop_nulls().to_list(), 0.0),
            "size_bytes": int(rows["size_bytes"].sum()),
        }


def failed(drives: Sequence[FleetDrive], reason: str) -> Done:
    """Return the result for drives that all failed for the same reason."""
    return of_rows([failed_row(drive, f"{drive.path}: {reason}") for drive in drives], [], {})


def joined(parts: Sequence[Done]) -> Done:
    """Return several results as one."""
    steps = dict.fromkeys(step for part in parts for step in part.seconds)
    return Done(
        recordings=pl.concat(part.recordings for part in parts),
        windows=pl.concat(part.windows for part in parts),
        seconds={step: sum(part.seconds.get(step, 0.0) for part in parts) for step in steps},
    )


def of_rows(rows: Sequence[Row], windows: Sequence[Row], seconds: dict[str, float]) -> Done:
    """Return the result of a chunk from its rows.

    seconds : processor time by step; the time to make the tables is added as the step ``rows``
    """
    began_s = time.process_time()
    recordings, of_windows = (
        pl.DataFrame([*map(_encodable, content)], schema=columns.schema(wanted))
        for content, wanted in ((rows, columns.RECORDINGS), (windows, columns.WINDOWS))
    )
    return Done(recordings, of_windows, seconds | {"rows": time.process_time() - began_s})


def _encodable(row: Row) -> Row:
    """Return a row whose texts show bytes of file names that are not UTF-8 as escapes."""
    texts = {key: value for key, value in row.items() if isinstance(value, str)}
    return row | {k: text.encode("utf-8", "backslashreplace").decode() for k, text in texts.items()}
