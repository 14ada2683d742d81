"""Sensor faults put into the lambda column of a table or of a logger's file.

The result is a table of the project's own form: ``time_s`` and one column per canonical signal. A
reading that a logger marks as no reading, at an end of its range, stays as it is, since nobody
knows the mixture there; so does a blank, unless the fault makes one.
"""

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from monitor.base.errors import RecordingError, UsageError
from monitor.base.files.outputs import write_text
from monitor.base.signals import OUTPUT
from monitor.grid.tables import TIME, Table
from monitor.inject.injection import FRAME_FAULTS, INVALID, Injection, check_begun
from monitor.inject.injector import SensorReading

SUFFIX = ".csv"
# in a table a blank of a sensor that is ready is the logger's
OF_FRAMES: Final = (*FRAME_FAULTS, "signal_missing", INVALID)


def with_faults(table: Table, injections: Sequence[Injection], seed: int = 0) -> tuple[Table, int]:
    """Return a table with faults on its lambda, and the number of rows that they change.

    Times of the faults count from the first row.
    Raises UsageError for a fault of frames or one that begins after the last row, RecordingError
    for a table without a lambda.
    """
    if OUTPUT not in table.names:
        raise RecordingError(f"{table.path}: has no {OUTPUT} to put a fault into")
    for each in injections:
        if each.name in OF_FRAMES:
            raise UsageError(f"{table.path}: {each.name} is a fault of frames, this is a table")
    check_begun(injections, int(table.t_ns[-1] - table.t_ns[0]))
    place, values = table.names.index(OUTPUT), table.values.copy()
    pinned = np.zeros(len(values), bool) if table.pinned is None else table.pinned[:, place]
    faults = [SensorReading(each, f"{seed}/{n}") for n, each in enumerate(injections)]
    for k, t_ns in enumerate((table.t_ns - table.t_ns[0]).tolist()):
        acting = [fault for fault in faults if fault.what.acts(t_ns)]
        reading = values.item(k, place)
        if not pinned[k]:
            for fault in acting:
                reading = fault.read(t_ns, reading)
            values[k, place] = reading
        for name, value in (pair for fault in acting for pair in fault.told.items()):
            if name in table.names:
                values[k, table.names.index(name)] = value
    changed = ~((values == table.values) | (np.isnan(values) & np.isnan(table.values)))
    return replace(table, values=values), int(changed.any(axis=1).sum())


def write_own(path: Path, table: Table) -> None:
    """Write a table of the project's own form; a value that is not known is a blank cell.

    Raises UsageError if the file has another suffix or cannot be written.
    """
    if path.suffix.lower() != SUFFIX:
        raise UsageError(f"{path}: a changed table is written as {SUFFIX}")
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")  # a column of the user's may have a comma
    writer.writerow((TIME, *table.names))
    for t_s, row in zip((table.t_ns / 1e9).tolist(), table.values.tolist(), strict=True):
        writer.writerow((t_s, *("" if math.isnan(value) else f"{value:.9g}" for value in row)))
    write_text(path, text.getvalue())
