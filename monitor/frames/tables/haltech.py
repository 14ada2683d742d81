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
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Final

from monitor.base.errors import RecordingError
from monitor.frames.bounds import head_of
from monitor.frames.tables.dialect import HEAD_BYTES, Dialect, encoding_of
from monitor.frames.tables.raw_table import DAY_S, RawColumn

MARK: Final = b"%DataLog%"
NO_VALUE: Final = float((1 << 23) - 1)
_ROW: Final = re.compile(r"^\d{1,2}:\d{2}:\d{2}", re.M)
# of a channel's type: unit, value of one step
TYPES: Final = tomllib.loads(files("monitor.frames.tables").joinpath("haltech.toml").read_text())


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
