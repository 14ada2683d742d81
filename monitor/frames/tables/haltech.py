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

Cells are whole numbers; the channel's type says of what. From NO_VALUE on, the largest number of 24
bits, they say that there is none, as -2147483645 and 2147483647 do. Source: Haltech's CAN broadcast
protocol, whose units the logs share, and public logs.
"""

import re
from pathlib import Path
from typing import Final

from monitor.base.errors import RecordingError
from monitor.frames.bounds import head_of
from monitor.frames.tables.dialect import HEAD_BYTES, Dialect, encoding_of
from monitor.frames.tables.raw_table import DAY_S, RawColumn

MARK: Final = b"%DataLog%"
NO_VALUE: Final = float((1 << 23) - 1)
_ROW: Final = re.compile(r"^\d{1,2}:\d{2}:\d{2}", re.M)
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


def haltech_dialect(path: Path) -> Dialect | None:
    """Return the dialect of the Haltech log in ``path``, None if it is another file.

    Raises RecordingError if it describes no channel.
    """
    head = head_of(path, HEAD_BYTES)
    if MARK not in head[:64]:
        return None
    encoding = encoding_of(head)
    description = _ROW.split(head.decode(encoding, errors="replace"), maxsplit=1)[0]
    columns, steps = [RawColumn("Time", "", "clock", DAY_S)], [1.0]
    for key, value in re.findall(r"^[ \t]*(Channel|Type)[ \t]*:(.*)", description, re.M):
        if key == "Channel":
            columns.append(RawColumn(value.strip()))
            steps.append(1.0)
        elif len(columns) > 1:
            unit, steps[-1] = TYPES.get(value.strip(), ("", 1.0))
            columns[-1] = RawColumn(columns[-1].name, unit)
    if len(columns) == 1:
        raise RecordingError(f"{path}: no line 'Channel : NAME' before the rows")
    return Dialect(
        kind="Haltech log, text",
        columns=tuple(columns),
        encoding=encoding,
        has_quotes=False,
        row=_ROW,
        steps=tuple(steps),
        preamble=MARK.decode(),
    )
