"""Recordings as users give them: files, columns in memory, or recordings read before."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from training.recordings.recording import Pairs, Recording, load, of_columns

Given = str | Path | Recording | Mapping[str, Any] | Any  # the last is a polars or pandas frame


def load_recordings(
    given: Given | Sequence[Given],
    *,
    period_s: float | None = None,
    buses: Pairs | None = None,
    channel: str = "",
    columns: str | Path | None = None,
    of_model: Mapping[str, Any] | None = None,
    one_grid: bool = False,
) -> list[Recording]:
    """Return recordings on one grid each.

    given : one or several CAN logs, tables, loggers' files; columns by name with ``time_s`` among
        them (dict of arrays, polars or pandas frame); or recordings, which are passed on
    period_s : sample period; default 0.1 s for CAN logs, the table's own for tables
    buses : pairs of DBC and signal map for CAN logs; default the project's own ECU
    channel : of logs that hold several buses
    columns : columns map or profile for tables
    of_model : profile in a model's card, for a logger's file that it fits
    one_grid : take the slowest period for all tables, as for loggers' files
    Raises RecordingError, UsageError or SignalMapError naming the file and what is wrong.

    >>> import numpy as np
    >>> drive = {"time_s": np.arange(100) / 10, "lambda_measured": np.ones(100)}
    >>> [recording] = load_recordings(drive)
    >>> recording.period_ns / 1e9, recording.names, len(recording.t_s)
    (0.1, ('lambda_measured',), 100)
    """
    several = given if isinstance(given, list | tuple) else [given]

    def read(number: int, one: Given, period_s: float | None) -> Recording:
        if isinstance(one, Recording):
            return one
        if isinstance(one, str | Path):
            how: dict[str, Any] = {"columns": columns, "of_model": of_model}
            return load(one, period_s=period_s, pairs=buses, channel=channel, **how)
        return of_columns(one, f"recording {number}", period_s)

    found = [read(number, one, period_s) for number, one in enumerate(several)]
    widest_ns = max((each.period_ns for each in found), default=0)
    slower = [each for each in found if each.period_ns != widest_ns]
    if period_s is None and any(one_grid or each.profile for each in slower):
        found = [
            each if each.period_ns == widest_ns else read(number, one, widest_ns / 1e9)
            for number, (one, each) in enumerate(zip(several, found, strict=True))
        ]
    return found
