"""Lines of a text log to frames, by the layout that its first lines tell."""

import csv
import math
import re
import tomllib
from base64 import b64decode
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.types import Frame
from monitor.frames.blocks import (
    FD_LENGTHS,
    LATEST_S,
    MAX_BYTES,
    CutShortError,
    LogCounters,
)
from monitor.frames.bounds import head_of
from monitor.frames.tables.cells import ColumnClock, clock, wrap_s
from monitor.frames.tables.dialect import encoding_of
from monitor.frames.tables.raw_table import DAY_S
from monitor.frames.text.frame_table import frame_table, times_of
from monitor.frames.text.lines import CUT_SHORT
from monitor.frames.text.tools import (
    ANY,
    ASC,
    CANDUMP,
    CONSOLE,
    LAYOUTS,
    PEAK,
    ROWS,
    TABLE,
    Groups,
    TextLayout,
    peak,
)

_HEAD_BYTES: Final = 1 << 14
_CLASSIC: Final = 8
_KVASER_EXTENDED: Final = 4
_KVASER_NO_DATA: Final = 0x21  # remote frame, error frame
_STANDARD: Final = 0x7FF  # largest identifier of 11 bits
_PEAK_EPOCH: Final = datetime(1899, 12, 30, tzinfo=timezone.utc)  # noqa: UP017
_RELATIVE: Final = re.compile(
    r"^base\s+\w+\s+timestamps\s+relative|^\*\*\*RELATIVE MODE", ANY | re.M
)
_DATE: Final = re.compile(
    r"^date +\w+ +(\w{3})\w* +(\d+) +([\d:.]+)( +[ap]m)? +(\d{4})", re.I | re.M
)
_ANEW: Final = re.compile(r"(?:date|base)\s|;\$STARTTIME=", re.I)  # another log in one file
_FIRST_LOG: Final = re.compile(r".*?^\s*\d+\.\d+\s.*?(?=^(?:date|base)\s|\Z)", ANY | re.M | re.S)
_COLOURS: Final = re.compile("\x1b\\[[0-9;]*m")  # of candump -c
_TIME: Final = re.compile(r"\s*(\d+\.\d+)\s")  # of any line of an .asc
# what is known and not read: suffixes or how it begins, what it is, and the tool that converts it
UNREAD: Final = tomllib.loads(
    files("monitor.frames.text").joinpath("unread.toml").read_text("utf-8")
)


class LayoutFound(NamedTuple):
    """The layout of a file in this encoding, None for an unknown one."""

    layout: TextLayout | None = None
    encoding: str = "utf-8"
    base: int = 16  # of identifiers and data
    deltas: bool = False  # each time is counted from the line before
    start_s: float = 0.0  # of the log, since 1970
    fd_base: int = 16  # of identifiers and data of CAN FD


def layout_of(path: Path, kind: str = "") -> LayoutFound:
    """Return the layout of a text log by its first lines, else by its suffix ``kind``.

    Raises RecordingError, without the file's name, for a tool whose logs are known, but not read,
    and OSError.
    """
    head = head_of(path, _HEAD_BYTES)
    for begin, told in UNREAD["content"].items():
        if head.startswith(begin.encode("latin1")):
            raise RecordingError(f"its content is {told}")
    encoding = encoding_of(head)
    text = head.decode(encoding, errors="replace").replace("\r\n", "\n").lstrip("\ufeff")
    is_candump = CANDUMP.begins.match(text)
    if is_candump and not re.match(r"\s*\(0+\.0+\)", text):  # no times since the line before
        return LayoutFound(CANDUMP, encoding)
    text = _COLOURS.sub("", text)
    layout = CANDUMP if is_candump else _known(text)
    for each in UNREAD["text"] if layout is None else ():
        if re.search(each["begins"], text, ANY | re.M):
            told = f"a CAN log, {each['is']}: not read, convert it with {each['converter']}"
            raise RecordingError(told)
    layout = layout or {".asc": ASC, ".trc": PEAK, ".log": CANDUMP}.get(kind)
    if layout is None:
        return LayoutFound(encoding=encoding)
    start_s = _start_s(text)
    text = (_FIRST_LOG.match(text) or [text])[0]
    layout = peak(text) if layout is PEAK else layout
    rows = list(filter(None, map(layout.groups, text.splitlines())))
    if rows and ":" in rows[0]["time"] and not layout.row:
        wraps_s = wrap_s(rows[0]["time"]) or math.inf
        layout = replace(layout, time_s=ColumnClock(), wraps_s=wraps_s)
    says_decimal = re.search(r"\*\*\*DEC\*\*\*|^base\s+dec|data field: DEC", text, ANY | re.M)
    base = 10 if says_decimal or _is_decimal(layout, rows) else 16
    fd = " ".join(row["data"] for row in rows if row.get("fd"))
    fd_base = 16 if re.search("[a-f]", fd, re.I) else base  # CANoe's, beside decimal ones
    return LayoutFound(layout, encoding, base, _are_deltas(layout, rows, text), start_s, fd_base)


def _known(text: str) -> TextLayout | None:
    """Return the layout that the first lines tell, None if it is none that is read."""
    layout = next((each for each in LAYOUTS if each.begins.search(text)), None)
    if layout is not ROWS:
        return layout or frame_table(text)
    rows = list(filter(None, map(ROWS.groups, text.splitlines())))
    times = [row["time"] for row in rows]
    told = "".join(row["dlc"] + row["length"] for row in rows)
    if not told and not re.search("[a-fx]", "".join(row["id"] + row["data"] for row in rows), re.I):
        return None  # numbers of any kind
    if not all(map(str.isdigit, times)) or len(times[0]) > 12:  # with a point, or since 1970
        return ROWS
    steps = {int(b) - int(a) for a, b in pairwise(times)}
    if min(steps) < 0 or max(steps) <= 1:  # a channel, or a counter of rows
        return None
    return replace(ROWS, **times_of("time", times=times, n_ids=len({row["id"] for row in rows})))


def _begun_anew(line: str, found: LayoutFound) -> LayoutFound:
    """Return what a line of a header changes."""
    if line.lower().startswith("base"):
        base = 10 if re.match(r"base\s+dec", line, ANY) else 16
        return found._replace(base=base, deltas=bool(_RELATIVE.search(line)))
    return found._replace(start_s=_start_s(line) or found.start_s)


def _start_s(text: str) -> float:
    """Return the time of PEAK's or Vector's header, English or German, since 1970; 0 for none."""
    if days := re.search(r"^;\$STARTTIME=([\d.]+)", text, ANY | re.M):
        return (_PEAK_EPOCH + timedelta(days=float(days[1]))).timestamp()
    date = _DATE.search(text)
    start_s = clock("{1}-{0}-{4} {2}{3}".format(*date.groups(""))) if date else 0.0
    return start_s if start_s > DAY_S else 0.0


def _is_decimal(layout: TextLayout, rows: Sequence[Groups]) -> bool:
    """Return whether bytes are decimal: of three digits, no letters; or of one as identifiers."""
    if not layout.tool.startswith("Kvaser") and layout.tool != TABLE.tool:
        return False
    is_hex = layout.id_base == 16
    data = [row["data"] for row in rows]
    ids = [row["id"] for row in rows if not is_hex]
    letters = re.search("[a-fx]", " ".join([*data, *ids]), re.I)
    lengths = {len(byte) for row in data for byte in re.split(r"[\s,;]+", row)}
    return not letters and (3 in lengths or (1 in lengths and not is_hex))


def _are_deltas(layout: TextLayout, rows: Sequence[Groups], text: str) -> bool:
    """Return whether times are those since the line before: Vector's and BusMaster's header say so.

    Those of candump -td begin with 0, as with -tz, fall often and the later ones are no larger.
    """
    if layout.tool not in (CONSOLE, CANDUMP.tool):
        return bool(_RELATIVE.search(text))
    times_s = np.array([layout.time_s(row["time"]) for row in rows])
    first, later = np.split(times_s, [(len(times_s) + 1) // 2])
    steps = np.diff(times_s)
    if not len(later) or first[0] or (steps > 0.0).sum() > 2 * (steps < 0.0).sum() + 1:
        return False
    return bool(np.median(later) <= first.max())


def frames_of_lines(
    lines: Iterator[str], found: LayoutFound, counters: LogCounters
) -> Iterator[tuple[Frame, str]]:
    """Yield the frames of a text log with their channels; damaged lines are left out and counted.

    Raises ValueError if too many lines are damaged.
    """
    layout, late_s, before_s = found.layout, 0.0, 0.0
    assert layout
    for number, raw in enumerate(layout.joined(lines), 1):
        line = raw.strip("\ufeff\r\n")
        line = (_COLOURS.sub("", line) if "\x1b" in line else line).rstrip().lstrip(" ")
        if layout.ends_lines and not raw.endswith("\n"):
            raise CutShortError(CUT_SHORT)
        if not line:
            continue
        try:
            if (groups := layout.groups(line)) is None:
                line = line.lstrip()  # of a table's row the first cells may be empty
                if not layout.other.fullmatch(line):
                    raise ValueError(line)
                if found.deltas and (time := _TIME.match(line)):
                    before_s += float(time[1])
                elif counters.frames and _ANEW.match(line):
                    found, before_s, late_s = _begun_anew(line, found), 0.0, 0.0
                continue
            time_s = layout.time_s(groups["time"]) + (before_s if found.deltas else 0.0)
            if time_s + late_s < before_s - layout.wraps_s / 2:
                late_s += layout.wraps_s
            before_s = time_s + late_s
            frame = _frame(groups, before_s, found)
            channel = groups.get("channel", "")
        except (ValueError, IndexError, csv.Error):
            counters.leave_out(number, line, f"a frame of {layout.tool} is wanted")
            continue
        if frame is None:
            counters.skipped += 1
        else:
            counters.frames += 1
            yield frame, channel


def frame_of_line(line: str) -> Frame | None:
    """Return the data frame of a line of candump, None for an error frame or a remote frame.

    Raises ValueError if the line has another format.

    >>> frame_of_line("(2) vcan0 7FF##1AABB")
    Frame(t_ns=2000000000, can_id=2047, is_extended=False, data=b'\\xaa\\xbb')
    """
    if (groups := CANDUMP.groups(line)) is None:
        raise ValueError("not a candump line")
    return _frame(groups, float(groups["time"]), LayoutFound(CANDUMP))


def _frame(groups: Groups, time_s: float, found: LayoutFound) -> Frame | None:
    """Return the frame of a line's groups, None for a remote or error frame."""
    flags = groups.get("flags", "")
    bits = int(flags) if flags.isdecimal() else 0  # of Kvaser
    if bits & _KVASER_NO_DATA or any(map(groups.get, ("remote", "error", "rtr"))):
        return None
    assert found.layout
    base = found.fd_base if groups.get("fd") else found.base
    told = groups.get("dec")
    can_id = int(told or groups["id"], 10 if told else found.layout.id_base or base)
    ext = groups.get("dec_ext" if told else "ext")
    is_extended = bool(ext or bits & _KVASER_EXTENDED) or can_id > _STANDARD
    data = _data(groups, base)
    if len(data) > MAX_BYTES or not abs(found.start_s + time_s) < LATEST_S or can_id >> 29:
        raise ValueError("no CAN frame")
    t_us = round(found.start_s * 1e6) + round(time_s * 1e6)
    return Frame(t_us * 1000, can_id, is_extended, data)


def _data(groups: Groups, base: int) -> bytes:
    """Return the data, as many bytes as the line says; raises ValueError if some lack."""
    code = groups.get("dlc", "")
    told = code or groups.get("length", "").lower().removeprefix("0x") or "-1"
    length = int(told, 16 if len(code) == 1 else 10)
    if packed := groups.get("base64"):
        data = b64decode(packed, validate=True)
    else:
        raw = groups.get("data", "")
        text = re.findall(r"[^\s;,:.-]+", raw)
        if len(text) == 1 and len(text[0]) > 3:  # without spaces
            text = re.findall("..?", text[0].lower().removeprefix("0x"))
            if len(text[-1]) == 1:  # a table program took a leading zero away
                raise ValueError("half a byte")
        if _CLASSIC < length < 16:  # a code of CAN FD, if the line has so many bytes
            n = FD_LENGTHS[length - _CLASSIC - 1]
            length = n if len(text) >= n or (code and groups.get("fd")) else length
        text = text if length < 0 else text[:length]  # a counter may stand behind the bytes
        data = bytes(int(byte, base) for byte in text)
    if _CLASSIC < length < 16 and len(data) <= _CLASSIC:
        length = _CLASSIC  # codes 9 to 15 of classic frames
    if len(data) < length:
        raise ValueError("bytes lack")
    return data if length < 0 else data[:length]
