"""Haltech's logs (CSV of NSP): channels are described one by one before rows without a header.

::

    %DataLog%
    DataLogVersion : 1.1
    Channel : Manifold Pressure
    ID : 224
    Type : AbsPressure
    DisplayMaxMin : 3000,0
    Log : 20230605 08:41:34
    08:41:34.000,1013,…

Cells are whole numbers; the channel's type says of what. Source: Haltech's CAN broadcast protocol,
whose units the logs share, and public logs.
"""

import re
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np

from monitor.base.counts import counted
from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from monitor.frames.bounds import open_binary, open_text
from monitor.frames.tables.cells import clock, number
from monitor.frames.tables.dialect import encoding_of
from monitor.frames.tables.raw_table import DAY_S, Notes, RawColumn, RawTable, Wanted

MARK: Final = b"%DataLog%"
_ROW: Final = re.compile(r"\d{1,2}:\d{2}:\d{2}")
_ROWS: Final = 1 << 13
_MOST_LINES: Final = 100_000  # of the channels' description
# type of a channel: (unit, value of one step)
TYPES: Final = {
    "EngineSpeed": ("rpm", 1.0),
    "AbsPressure": ("kPa", 0.1),
    "Pressure": ("kPa", 0.1),
    "Percentage": ("%", 0.1),
    "Angle": ("deg", 0.1),
    "BatteryVoltage": ("V", 0.001),
    "Temperature": ("K", 0.1),
    "Speed": ("km/h", 0.1),
    "AFR": ("lambda", 0.001),
    "Time_us": ("ms", 0.001),
    "Time_ms": ("ms", 1.0),
    "Time_ms_as_s": ("s", 0.001),
    "Time_s": ("s", 1.0),
    "Current_uA_as_mA": ("mA", 0.001),
    "MassOverTime": ("g/s", 1.0),
    "MassPerCyl": ("mg", 1.0),
}


def is_haltech(path: Path) -> bool:
    """Return whether the file begins as a Haltech log does."""
    with open_binary(path) as file:
        return MARK in file.read(64)


def open_haltech(path: Path) -> RawTable:
    """Return the log in ``path``.

    Raises RecordingError if it describes no channel.
    """
    with open_binary(path) as binary:
        encoding = encoding_of(binary.read(1 << 16))
    columns = [RawColumn("Time", "", "clock", DAY_S)]
    steps = [1.0]
    with open_text(path, encoding, errors="replace") as file:
        for line in islice(file, _MOST_LINES):
            if _ROW.match(line):
                break
            name, _, value = (part.strip() for part in line.partition(":"))
            if name == "Channel":
                columns.append(RawColumn(value))
                steps.append(1.0)
            elif name == "Type" and len(columns) > 1:
                unit, steps[-1] = TYPES.get(value, ("", 1.0))
                columns[-1] = RawColumn(columns[-1].name, unit)
    if len(columns) == 1:
        raise RecordingError(f"{path}: no line 'Channel : NAME' before the rows")
    read = partial(_read, path, encoding, tuple(steps))
    return RawTable(path, "Haltech log, text", tuple(columns), read, MARK.decode())


def _read(
    path: Path, encoding: str, steps: Sequence[float], wanted: Sequence[Wanted], notes: Notes
) -> Iterator[FloatArray]:
    with open_text(path, encoding, errors="replace") as file:
        rows = _rows(path, file, len(steps), notes)
        while block := list(islice(rows, _ROWS)):
            yield np.array(
                [
                    [
                        number(row[each.column]) * steps[each.column]
                        if each.column
                        else clock(row[0])
                        for each in wanted
                    ]
                    for row in block
                ]
            ).reshape(len(block), len(wanted))


def _rows(path: Path, lines: Iterator[str], width: int, notes: Notes) -> Iterator[list[str]]:
    short: tuple[int, int] | None = None
    for line_number, line in enumerate(lines, 1):
        if not _ROW.match(line):
            continue
        row = line.rstrip("\r\n").split(",")
        if short is not None:
            n = counted(short[1], "cell")
            raise RecordingError(f"{path}: line {short[0]}: {n}, {width} are wanted")
        if len(row) < width:
            short = line_number, len(row)
            continue
        yield row
    if short is not None:
        notes.sentences.append(
            f"cut short in line {short[0]}: {short[1]} of {counted(width, 'cell')}"
        )
