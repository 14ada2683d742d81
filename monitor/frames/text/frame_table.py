"""Tables of CAN frames: the names of their columns tell which part of a frame they hold."""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final

import numpy as np

from monitor.base.errors import RecordingError
from monitor.frames.tables.cells import ColumnClock, wrap_s
from monitor.frames.tables.dialect import name_and_unit
from monitor.frames.tables.raw_table import DAY_S
from monitor.frames.text.tools import ANY, COUNT_S, TABLE, Groups, TextLayout, counted_s, seconds
from monitor.frames.units import unit_of

_HEADER_WITHIN: Final = 60  # lines of a table
_OF: Final = r"(?:(?:can|arb\w*|frame|m\w*g\w*)[ _-]?)?"
_PARTS: Final = {  # of a frame by their first word, and the names of the column that may hold it
    "time": r"(?!.*(?:delta|cycle|diff|interval|period|since[ _](?:last|prev)|zyklus))"
    r"(?:(?:abs|start|rx|(?!rel)\w+[ _])?(?:time|zeit).*|offset.*|ts|milli\w*|micro\w*|seconds|"
    "系统时间|时间标识|时间)",
    "id": rf"{_OF}(?:id|identifier|addr\w*)(?:_...)?\b.*|帧?id号?",
    "channel": r"(?:can[ _-]?)?(?:bus|channel|chan|chn?|kanal|interface|iface|network|net)"
    r"(?:[ _]?(?:channel|id|no|nr|num\w*))?\.?|(?:can)?通道号?",
    "channel of an adapter": r"can|device|(?:can[ _-]?)?port\b.*",
    "length": rf"{_OF}(?:data ?)?len(?:gth)?|size|dlc|(?:数据)?长度",
    "ext": r"(?:is[_ ]?)?ext\w*|ide|xtd|format|frame|帧格式",
    "remote": "(?:is[_ ]?)?(?:remote|rtr)",
    "error": r"er|(?:is[_ ]?)?err\w*",
    "kind": rf"(?:id[ _]?|{_OF})(?:type|format)|帧类型",
    "flags": "flags?",
    "data": rf"{_OF}(?:data|daten|payload)(?:[ _]?bytes?)?(?:[ _]?[(\[]?hex[)\]]?)?|"
    r"数据(?:\(hex\))?",
    "data in bytes": "(?:data|byte|d|b)[ _]?[01]",
    "data called": "message",  # elsewhere a name
}
_BYTE: Final = re.compile(r"(?:data|byte|d|b)[ _]?(\d+)")
_TIME: Final = re.compile(r"-?\d+(?:[.,]\d*)?|.*(?:\d:\d|\d\dT\d{6}).*")
_ID: Final = re.compile("((?:0x)?[0-9a-f]{1,9})[hx]?", ANY)
_BYTES: Final = re.compile(r"(?= |(?:0x)?[0-9a-f]{1,3} )((?: *(?:0x)?[0-9a-f]{0,3} +)*+)()", ANY)
_DATA: Final = re.compile(
    r"(?:x\|)? *(?:\[([0-9a-fx, ]*)\]|([0-9a-f: -]*+(?:(?<=0)x[0-9a-f: -]*+)*))", ANY
)
_YES: Final = re.compile("t|true|1|x|yes", re.I)
_KINDS: Final = {  # what the words of a cell make of a frame, or the name of a column with a yes
    "ext": re.compile(r"\bext|xtd|29.?bit|扩展帧", re.I),
    "remote": re.compile(r"\brem|rtr|远程帧", re.I),
    "error": re.compile(r"(?<!no.)\berr", re.I),
}
_SAYING: Final = (*_KINDS, "kind")
_FRAMES_US: Final = (50.0, 250.0)  # least step of two frames, and of two with one identifier
_FROM_WHEN: Final = re.compile("abs(?:olute)?|rel(?:ative)?", re.I)  # in brackets, where a unit may
_CYCLE: Final = 3000.0  # an identifier comes oftener than every 3000 ms, and not every 3000 µs


def frame_table(text: str) -> TextLayout | None:
    """Return the layout of a table of frames, None if the text is none."""
    lines = text.splitlines()[:_HEADER_WITHIN]
    for number, line in enumerate(lines):
        for sep in ",;\t" if re.search("id|addr", line, re.I) else "":
            told = [name.strip(' %"') for name in _cells(line, sep)]
            every = [re.sub(r".*\.(?=[a-z_]\w*$)", "", name.casefold()) for name in told]
            clock_alone = ["" if name.startswith("time") else name for name in every]
            for names in every, clock_alone:  # the adapter's time may be a hexadecimal count
                if (columns := _columns(names, sep)) is None:
                    continue
                if rows := [*filter(None, map(columns.row, lines[number + 1 :]))]:
                    ids = {row["id"] for row in rows}
                    base = _id_base(told[columns.places["id"]], ids)
                    named, times = columns.places["time"], [row["time"] for row in rows]
                    way = times_of(*names[named:][:2], times=times, n_ids=len(ids))
                    return replace(TABLE, row=columns.row, id_base=base, **way)
    return None


@dataclass(frozen=True, slots=True)
class _FrameColumns:
    """The columns of a table of frames, by the parts of a frame."""

    sep: str
    places: dict[str, int]
    last: int  # of them
    n_bytes: int  # columns of data, of which rows may lack some

    def row(self, line: str) -> Groups | None:
        """Return the parts of a row with a frame, None for any other line."""
        cells = _cells(line, self.sep)
        if len(cells) <= self.last:
            return None
        found = {part: cells[place] for part, place in self.places.items()}
        if self.n_bytes > 1:
            found["data"] = " ".join(cells[self.last : self.last + self.n_bytes])
        can_id, data = _ID.fullmatch(found["id"]), _DATA.fullmatch(found["data"])
        if not data and self.n_bytes > 1:  # up to what stands behind the last byte
            data = _BYTES.match(found["data"] + " ")
        if not (can_id and data and _TIME.fullmatch(found["time"])):
            return None
        found["id"], found["data"] = can_id[1], data[1] or data[2] or ""
        found.update(_said(*map(found.get, _SAYING)))
        return found


def _columns(names: Sequence[str], sep: str) -> _FrameColumns | None:
    """Return the columns of a frame's parts, None if time, identifier or data lack.

    Of several that fit, a hexadecimal one comes first, and those of a header or computer last.
    """
    places, free = dict[str, int](), [*names]
    for named, form in _PARTS.items():
        part = named.split()[0]
        fitting = [
            ("hex" not in n or "time" in n, n != "id", not n.startswith("time"), i)
            for i, n in enumerate(free)
            if re.fullmatch(form, n)
        ]
        if fitting and part not in places:
            places[part] = min(fitting)[-1]
            free[places[part]] = ""
    numbers = [int(n[1]) for n in map(_BYTE.fullmatch, names) if n]
    first = places.get("data", -1)
    in_bytes = first >= 0 and _BYTE.fullmatch(names[first])
    if in_bytes:
        places = {part: place for part, place in places.items() if place <= first}
    if not {"time", "id", "data"} <= places.keys() or numbers != sorted(numbers):
        return None  # or the last byte stands first
    return _FrameColumns(sep, places, max(places.values()), len(numbers) if in_bytes else 1)


def _cells(line: str, sep: str) -> list[str]:
    line = line.replace('="', '"')
    if '"' in line and line.count('"') % 2 == 0:
        cells = next(csv.reader((line,), delimiter=sep, skipinitialspace=True))
        return [*map(str.strip, cells)]
    if '"' in line:  # one that opens nothing, as in a column of ASCII
        return [cell.strip(' "') for cell in line.split(sep)]
    return [*map(str.strip, line.split(sep))] if " " in line else line.split(sep)


@lru_cache(maxsize=1 << 10)
def _said(*cells: str | None) -> dict[str, str]:
    """Return what the cells of a row say of the kind of its frame."""
    *own, kind = (cell or "" for cell in cells)
    said = {}
    for (part, form), cell in zip(_KINDS.items(), own, strict=True):
        is_said = _YES.fullmatch(cell) or form.match(cell) or form.search(kind)
        said[part] = "yes" if is_said else ""
    return said


def times_of(named: str, behind: str = "", *, times: Sequence[str], n_ids: int) -> dict[str, Any]:
    """Return the way to seconds, and when the count begins anew, as fields of ``TextLayout``.

    The unit of the column ``named`` tells it, else digits and identifiers.
    behind : the column beside it
    Raises RecordingError for times that fall or whose unit is open, or of which a part is beside.
    """
    stated = _FROM_WHEN.sub("", name_and_unit(named)[1])
    unit, part = (unit_of(each, 1.0) for each in (stated or named.rpartition("_")[2], behind))
    is_whole = not any(mark in time for time in times for mark in ".,")
    is_coarse = is_whole and (unit is None or unit.factor >= 1.0)
    if is_coarse and part and part.quantity == "time" and part.factor < 1.0:
        raise RecordingError(f"its time stands in two columns, {named} and {behind}: one is wanted")
    is_clock = any(mark in time for time in times for mark in ":Tt")
    values = np.array(list(map(ColumnClock() if is_clock else seconds, times)))
    steps, step = np.diff(values), np.ptp(values) / max(1, len(values) - 1)
    falls, rises = steps[steps < 0.0], steps[steps > 0.0]
    if 3 * len(falls) > 1 + len(rises) and -2.0 * falls.sum() > rises.sum():
        raise RecordingError(f"its {named} falls from row to row: rising times are wanted")
    if is_clock:
        return {"time_s": ColumnClock(), "wraps_s": wrap_s(times[0]) or np.inf}
    if unit and unit.quantity == "time":
        step_s = unit.factor
    elif values[0] > 1e12:  # since 1970
        return {"time_s": counted_s}
    elif not is_whole:
        is_fine = any(re.search(r"[.,]\d{4}", time) for time in times)  # no ms are as fine
        step_s = 1.0 if step < 1.0 or is_fine else 1e-3
    elif stated:
        raise RecordingError(f"its column {named} counts in an unknown unit: call it time_us, …")
    elif _FRAMES_US[1] <= step * n_ids < _CYCLE and min(filter(None, steps)) >= _FRAMES_US[0]:
        raise RecordingError(f"its {named} may be in ms or µs: call it time_ms or time_us")
    else:
        step_s = 1e-6 if step * n_ids >= _CYCLE else 1e-3
    wraps_s = COUNT_S if step_s == 1e-6 else DAY_S
    return {"time_s": lambda text: seconds(text) * step_s, "wraps_s": wraps_s}


def _id_base(named: str, ids: set[str]) -> int:
    """Return the base of identifiers, 0 if nothing tells it: 10 by the tool, or by large ones.

    named : the name of their column
    """
    if not "".join(ids).isdecimal() or re.search("hex", named, re.I):
        return 16
    is_large = any(int(each, 16) >> 29 or re.fullmatch("1...|20[0-4].", each) for each in ids)
    is_said = re.search(r"\b(can\.id|addr|arb\w*_id)\b|[ _(]dec", named, re.I)
    return 10 if is_large or is_said else 0
