"""CAN logs that other tools write as text: a pattern for each tool.

A layout says how a log of the tool begins, what a line with a frame looks like, and which lines are
none. Sources: the tools' documentation and logs, and the formats that SavvyCAN reads.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

from monitor.base.errors import RecordingError
from monitor.base.types import Frame
from monitor.frames.blocks import LATEST_S, MAX_BYTES, LogCounters
from monitor.frames.bounds import open_binary
from monitor.frames.tables.dialect import encoding_of
from monitor.frames.text.candump import WANTED, frame_of_line

_HEAD_BYTES: Final = 1 << 14
_CLASSIC: Final = 8
_DAY_S: Final = 86_400.0
_KVASER_EXTENDED: Final = 4
_KVASER_NO_DATA: Final = 0x21  # remote frame, error frame
_STANDARD: Final = 0x7FF  # largest identifier of 11 bits


def _seconds(text: str) -> float:
    """Return a number of seconds; a decimal comma counts."""
    return float(text.replace(",", "."))


def _milliseconds(text: str) -> float:
    """Return the seconds of a time in ms, or of one in s with a decimal point."""
    return float(text) if "." in text else int(text) / 1e3


def _clock(text: str) -> float:
    """Return the seconds of h:m:s:f or h:m:s.f, the last part a fraction of the second."""
    hours, minutes, seconds, *fraction = re.split(r"[:.]", text)
    value = 3600.0 * int(hours) + 60.0 * int(minutes) + int(seconds)
    return value + float(f"0.{fraction[0]}") if fraction else value


def _stamp(text: str) -> float:
    """Return the seconds of candump's time: a number, or date and time of day (UTC)."""
    if " " not in text:
        return float(text)
    moment = datetime.strptime(text, "%Y-%m-%d %H:%M:%S.%f")
    return moment.replace(tzinfo=timezone.utc).timestamp()  # noqa: UP017


@dataclass(frozen=True, slots=True, kw_only=True)
class TextLayout:
    """How a tool writes frames as lines of text.

    frame has the groups time, id and data, and where the tool writes them channel, ext, length,
    remote and error. A line that fits neither ``frame`` nor ``other`` is damaged.
    """

    tool: str
    begins: re.Pattern[str]  # somewhere in the first lines
    frame: re.Pattern[str]
    other: re.Pattern[str]  # lines that are no frame
    time_s: Callable[[str], float]
    wraps: bool = False  # the time of day, which begins anew at midnight


_ANY: Final = re.IGNORECASE | re.ASCII
_BYTES: Final = r"(?P<data>(?:[\s;,](?:0x)?[0-9a-f]{1,3})*)"
_NOTHING: Final = re.compile(r"(?!)")

LAYOUTS: Final = (
    TextLayout(
        tool="candump on a console",
        begins=re.compile(
            r"^ *\([\d.: -]+\) +\S+ +(?:[RT]X [-B] [-E] +)?[0-9A-F]{3,8} +\[\d+\]", re.M
        ),
        frame=re.compile(
            r"\s*\((?P<time>[\d.: -]+)\)\s+(?P<channel>\S+)\s+(?:[RT]X\s+[-B]\s+[-E]\s+)?"
            r"(?P<id>[0-9a-f]{3}|(?P<ext>[0-9a-f]{8}))\s+\[(?P<length>\d+)\]\s*"
            r"(?:(?P<remote>remote request)|(?P<data>(?:\s?[0-9a-f]{2}\b)*))"
            r"\s*(?P<error>ERRORFRAME)?(?:\s+'.*'?)?\s*", _ANY,
        ),
        other=_NOTHING,
        time_s=_stamp,
    ),
    TextLayout(
        tool="SavvyCAN (GVRET)",
        begins=re.compile(r"^Time ?Stamp,ID,Extended,(?:Dir,)?Bus,LEN,", _ANY | re.M),
        frame=re.compile(
            r"(?P<time>-?\d+),(?P<id>[0-9a-f]+),(?:(?P<ext>true|1)|false|0),(?:[RT]x,)?"
            r"(?P<channel>\d+),(?P<length>\d+)" + _BYTES + r"[,\s]*", _ANY,
        ),
        other=re.compile(r"Time ?Stamp,.*", _ANY),
        time_s=lambda text: int(text) / 1e6,
    ),
    TextLayout(
        tool="BusMaster",
        begins=re.compile(r"^\*\*\*BUSMASTER", re.M),
        frame=re.compile(
            r"(?P<time>\d+:\d+:\d+:\d+)\s+[RT]x\s+(?P<channel>\d+)\s+(?P<id>(?:0x)?[0-9a-f]+)\s+"
            r"(?:s|(?P<ext>x))(?P<remote>r)?\s+(?P<length>\d+)" + _BYTES + r"\s*", _ANY,
        ),
        other=re.compile(r"\*\*\*.*|.*\bERR\b.*", _ANY),
        time_s=_clock,
        wraps=True,
    ),
    TextLayout(
        tool="CanHacker",
        begins=re.compile(r"^\s*Time\s+ID\s+DLC\s+Data\b", _ANY | re.M),
        frame=re.compile(
            r"\s*(?P<time>\d+[.,]\d+)\s+(?P<id>[0-9a-f]{1,3}|(?P<ext>[0-9a-f]{4,8}))\s+"
            r"(?P<length>\d+)(?:\s+(?P<remote>RTR)|(?P<data>(?:\s+[0-9a-f]{2}\b)*))(?:\s.*)?", _ANY,
        ),
        other=re.compile(r"\s*Time\s+ID\s+DLC.*", _ANY),
        time_s=_seconds,
    ),
    TextLayout(
        tool="Kvaser CanKing",
        begins=re.compile(r"^\s*Chn\s+Identifier\s+Flg\s+DLC", _ANY | re.M),
        frame=re.compile(
            r"\s*(?P<channel>\d+)\s+(?P<id>[0-9a-f]+)\s+(?P<flags>(?:[a-wyz]|(?P<ext>x))*)\s+"
            r"(?P<length>\d+)(?P<data>(?:\s+[0-9a-f]{1,3})*)\s+(?P<time>\d+\.\d+)\s+[RT]\s*", _ANY,
        ),
        other=re.compile(r"\s*Chn\s+Identifier.*|.*ErrorFrame.*|\s*[a-z].*|-+.*", _ANY),
        time_s=float,
    ),
    TextLayout(
        tool="Kvaser CSV",
        begins=re.compile(r"^Time,Channel,ID,Flags,DLC,Data0,.*,Counter\b", _ANY | re.M),
        frame=re.compile(
            r"(?P<time>\d+\.\d+),(?P<channel>\d+),(?P<id>(?:0x)?[0-9a-f]+),(?P<flags>\d+),"
            r"(?P<length>\d+)(?P<data>(?:,(?:(?:0x)?[0-9a-f]{1,3})?)*)(?:,.*)?", _ANY,
        ),
        other=re.compile(r"Time,.*", _ANY),
        time_s=float,
    ),
    TextLayout(
        tool="Vehicle Spy",
        begins=re.compile(r"^Line,Abs Time ?\(Sec\),.*,Arb ID,", _ANY | re.M),
        frame=re.compile(
            r"\d+,(?P<time>-?\d+(?:\.\d+)?),[^,]*,[^,]*,(?:(?P<error>T)|F?),[^,]*,"
            r"(?:\"[^\"]*\"|[^,]*),(?P<channel>[^,]*),[^,]*,(?P<id>[0-9a-f]+),"
            r"(?:(?P<remote>T\b)|[^,]*),(?:(?P<ext>T)|F)"
            r"(?P<data>(?:,(?:[0-9a-f]{2})?){8})(?:,.*)?", _ANY,
        ),
        other=re.compile(r"[a-z,].*", _ANY),
        time_s=float,
    ),
    TextLayout(
        tool="CRTD (OVMS)",
        begins=re.compile(r"^\d+\.\d+ \d*(?:C[A-Z]{2}\b|[RT](?:11|29) )", re.M),
        frame=re.compile(
            r"(?P<time>\d+\.\d+)\s+(?P<channel>\d*)[RT](?:11|(?P<ext>29))\s+(?P<id>[0-9a-f]+)"
            r"(?P<data>(?:\s+[0-9a-f]{2})*)\s*", _ANY,
        ),
        other=re.compile(r"\d+\.\d+\s+\d*C[A-Z]{2}\b.*"),
        time_s=float,
    ),
    TextLayout(
        tool="Microchip CAN BUS Analyzer",
        begins=re.compile(r"Microchip Technology|^CAN BUS Analyzer", re.M),
        frame=re.compile(
            r"(?P<time>\d+(?:\.\d+)?);[RT]X;(?P<id>0x[0-9a-f]+);(?P<length>\d+)"
            + _BYTES + r"[;\s]*",
            _ANY,
        ),
        other=re.compile(r"[^;]*"),
        time_s=_milliseconds,
    ),
    TextLayout(
        tool="IXXAT",
        begins=re.compile(r"^ASCII Trace IXXAT", _ANY | re.M),
        frame=re.compile(
            r'"(?P<time>\d+:\d+:\d+\.\d+)","(?P<id>[0-9a-f]+)","(?:Std|(?P<ext>Ext))",'
            r'"[^"]*","(?P<data>[0-9a-f ]*)"\s*', _ANY,
        ),
        other=re.compile(r'[a-z].*|"Time".*', _ANY),
        time_s=_clock,
        wraps=True,
    ),
    TextLayout(
        tool="CANedge (CSV)",
        begins=re.compile(r"^TimestampEpoch;BusChannel;ID;IDE;DLC;", re.M),
        frame=re.compile(
            r"(?P<time>\d+\.\d+);(?P<channel>\d+);(?P<id>[0-9a-f]+);(?:0|(?P<ext>1));\d+;"
            r"(?P<length>\d+);\d;\d;\d;\d;(?:(?P<remote>1)|0);(?P<data>[0-9a-f]*)\s*", _ANY,
        ),
        other=re.compile(r"TimestampEpoch;.*"),
        time_s=float,
    ),
)  # fmt: skip
# what is known and not read: how it begins, and the tool that converts it
UNREAD: Final = (
    (re.compile(r"Vehicle Spy|^Line,Abs Time\(Sec\),", re.M),
     "Vehicle Spy without arbitration identifiers", "Vehicle Spy's own export"),
    (re.compile(r"^# Logger type: CL\d000", re.M), "a CLX000 logger", "its CLX000 converters"),
    (re.compile(r"^Time[^,;\n]*[,;](?:CAN )?(?:Channel|ID|Identifier)[,;]", _ANY | re.M),
     "frames as CSV", "SavvyCAN or python-can's can_logconvert"),
    (re.compile(r"^ *\S+ +[0-9A-F]{3,8} +\[\d+\]  [0-9A-F ]+$", re.M),
     "candump without times", "candump -L, which writes them"),
)  # fmt: skip


class LayoutFound(NamedTuple):
    """The layout of a file: None for a log of candump, python-can or Vector in this encoding."""

    layout: TextLayout | None = None
    encoding: str = "utf-8"
    base: int = 16  # of identifiers and data
    deltas: bool = False  # each time is counted from the frame before


def layout_of(path: Path) -> LayoutFound:
    """Return the layout of a text log by its first lines.

    Raises RecordingError, without the file's name, for a tool whose logs are known, but not read,
    and OSError.
    """
    head = b""
    with open_binary(path) as file, suppress(EOFError, ValueError):  # the reader tells damage
        while len(head) < _HEAD_BYTES and (piece := file.read(_HEAD_BYTES >> 4)):
            head += piece
    encoding = encoding_of(head)
    text = head.decode(encoding, errors="replace").replace("\r\n", "\n").lstrip("\ufeff")
    for layout in LAYOUTS:
        if layout.begins.search(text):
            rows = list(filter(None, map(layout.frame.fullmatch, text.splitlines())))
            base = 10 if "***DEC***" in text or _is_decimal(layout, rows) else 16
            return LayoutFound(layout, encoding, base, _are_deltas(layout, rows))
    for begins, tool, converter in UNREAD:
        if begins.search(text):
            raise RecordingError(f"a CAN log, {tool}: not read, convert it with {converter}")
    return LayoutFound(encoding=encoding)


def _is_decimal(layout: TextLayout, rows: Sequence[re.Match[str]]) -> bool:
    """Return whether a Kvaser tool writes decimal numbers: bytes of three digits, no letters."""
    if not layout.tool.startswith("Kvaser"):
        return False
    words = [re.split(r"[\s,]+", f"{row['id']} {row['data']}") for row in rows]
    letters = any(re.search("[a-fx]", " ".join(row), re.I) for row in words)
    return not letters and any(len(byte) > 2 for row in words for byte in row[1:])


def _are_deltas(layout: TextLayout, rows: Sequence[re.Match[str]]) -> bool:
    """Return whether the times of candump -td: they begin with 0, as with -tz, and fall, too."""
    if layout is not LAYOUTS[0]:
        return False
    times_s = [layout.time_s(row["time"]) for row in rows]
    return times_s[:1] == [0.0] and any(b < a for a, b in pairwise(times_s))


def frames_of_lines(
    lines: Iterator[str], found: LayoutFound, counters: LogCounters
) -> Iterator[tuple[Frame, str]]:
    """Yield the frames of a text log with their channels; damaged lines are left out and counted.

    Raises ValueError if too many lines are damaged.
    """
    layout, late_s, before_s = found.layout, 0.0, 0.0
    for number, raw in enumerate(lines, 1):
        line = raw.strip("\ufeff\r\n")
        if not line.strip():
            continue
        try:
            if layout is None:
                frame, channel = frame_of_line(line), line.split(maxsplit=2)[1]
            else:
                match = layout.frame.fullmatch(line.rstrip())
                if match is None:
                    if layout.other.fullmatch(line.rstrip()):
                        continue
                    raise ValueError(line)
                time_s = layout.time_s(match["time"]) + (before_s if found.deltas else 0.0)
                if layout.wraps and time_s + late_s < before_s - _DAY_S / 2:
                    late_s += _DAY_S
                before_s = time_s + late_s
                groups = match.groupdict()
                frame, channel = _frame(groups, before_s, found.base), groups.get("channel") or ""
        except (ValueError, IndexError):
            wanted = f"a frame of {layout.tool} is wanted" if layout else WANTED
            counters.leave_out(number, line, wanted)
            continue
        if frame is None:
            counters.skipped += 1
        else:
            counters.frames += 1
            yield frame, channel


def _frame(groups: dict[str, str | None], time_s: float, base: int) -> Frame | None:
    """Return the frame of a line's groups, None for a remote or error frame."""
    if groups.get("remote") or groups.get("error"):
        return None
    flags = groups.get("flags") or ""
    bits = int(flags) if flags.isdecimal() else 0  # of Kvaser
    if bits & _KVASER_NO_DATA:
        return None
    text = (groups["data"] or "").replace(";", " ").replace(",", " ").split()
    if len(text) == 1 and len(text[0]) > 3 and "x" not in text[0]:  # without spaces
        text = re.findall("..", text[0])
    length = int(groups.get("length") or len(text))
    can_id = int(groups["id"] or "", base)
    if _CLASSIC < length < 16 and len(text) <= _CLASSIC:
        length = _CLASSIC  # codes 9 to 15 of classic frames
    data = bytes(int(byte, base) for byte in text[:length])
    if len(data) < length or length > MAX_BYTES or not abs(time_s) < LATEST_S or can_id >> 29:
        raise ValueError("no CAN frame")
    is_extended = bool(groups.get("ext") or bits & _KVASER_EXTENDED) or can_id > _STANDARD
    return Frame(round(time_s * 1e6) * 1000, can_id, is_extended, data)
