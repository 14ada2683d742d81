"""CAN logs that other tools write as text: a pattern for each tool.

A layout says how a log of the tool begins, what a line with a frame looks like, and which lines are
none. Sources: the tools' documentation and logs, and the formats that SavvyCAN reads.
"""

import csv
import math
import re
import tomllib
from base64 import b64decode
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta, timezone
from importlib.resources import files
from itertools import pairwise
from operator import gt, lt
from pathlib import Path
from statistics import median
from typing import Any, Final, NamedTuple

from monitor.base.errors import RecordingError
from monitor.base.types import Frame
from monitor.frames.blocks import (
    EXTENDED,
    FD_LENGTHS,
    LATEST_S,
    MAX_BYTES,
    CutShortError,
    LogCounters,
)
from monitor.frames.bounds import head_of
from monitor.frames.tables.cells import ColumnClock, clock
from monitor.frames.tables.dialect import encoding_of, name_and_unit
from monitor.frames.text.lines import CUT_SHORT
from monitor.frames.units import unit_of

_HEAD_BYTES: Final = 1 << 14
_CLASSIC: Final = 8
_DAY_S: Final = 86_400.0
_KVASER_EXTENDED: Final = 4
_KVASER_NO_DATA: Final = 0x21  # remote frame, error frame
_STANDARD: Final = 0x7FF  # largest identifier of 11 bits
_PEAK_EPOCH: Final = datetime(1899, 12, 30, tzinfo=timezone.utc)  # noqa: UP017


def _seconds(text: str) -> float:
    """Return a number of seconds; a decimal comma counts."""
    return float(text.replace(",", "."))


@dataclass(frozen=True, slots=True, kw_only=True)
class TextLayout:
    """How a tool writes frames as lines of text.

    A pattern of frames has the groups time, id and data or base64, and where the tool writes them
    channel, ext, length or dlc (its code), fd, dec (a decimal id), remote and error. A line that
    fits neither ``frames`` nor ``other`` is damaged.
    """

    tool: str
    begins: re.Pattern[str]  # somewhere in the first lines
    frames: tuple[re.Pattern[str], ...]
    other: re.Pattern[str]  # lines that are no frame
    time_s: Callable[[str], float] = _seconds
    id_base: int = 0  # of identifiers, 0 that of the data
    wraps_s: float = math.inf  # after which a clock or a counter begins anew
    ends_lines: bool = False  # with a line end, the last one, too
    joined: Callable[[Iterator[str]], Iterator[str]] = iter  # lines of frames from those of a file

    def match(self, line: str) -> re.Match[str] | None:
        """Return the groups of a line with a frame."""
        return next(filter(None, (frame.fullmatch(line) for frame in self.frames)), None)


def _counted_s(text: str) -> float:
    """Return a number of seconds; whole ones are of ms."""
    return _seconds(text) / (1.0 if "." in text else 1e3)


def _told_s(text: str) -> float:
    """Return a number of seconds; 13 digits before its point and more are of ms, µs or ns."""
    return _seconds(text) * 1e-3 ** max(0, (len(re.split("[.,]", text)[0]) - 10) // 3)


_ANY: Final = re.IGNORECASE | re.ASCII
_CELLS: Final = {  # of a line, as the patterns below name them
    "time": r"(?P<time>\d+(?:[.,]\d+)?)",
    "clock": r"(?P<time>\d+:\d+:\d+:\d+)",
    "moment": r"(?P<time>(?:\d+-\d+-\d+[ T])?[\d:]+(?:[.,]\d+)?)(?![-:.,/]?\d)",  # all of it
    "channel": r"(?P<channel>\d+)",
    "id": r"(?P<id>(?:0x)?[0-9a-f]+)",
    "short": r"(?P<id>[0-9a-f]{1,4}|(?P<ext>[0-9a-f]{8}))",
    "ext": r"(?P<ext>x)",
    "remote": r"(?P<remote>r)",
    "length": r"(?P<length>\d+)",
    "data": r"(?P<data>(?:(?:\s+|[;,])(?:0x)?[0-9a-f]{1,3}\b)*)",
}
_ROW: Final = (
    r"\[?(?P<time>(?:\d{4}-\d\d-\d\d[T ])?\d\d:\d\d:\d\d(?:\.\d+)?|\d{10}\.\d+|\d+(?:\.\d{4,})?)"
    r"\]?:?[,; \t]+(?:[RT]X?[:,; \t]+)?"
    r"(?P<id>0x[0-9a-f]{1,7}|[0-9a-f]{3,7}|(?P<ext>(?:0x)?[0-9a-f]{8})):?[,; \t]+"
    r"(?:(?:\[(?P<length>\d+)\]|(?P<dlc>\d))[,; \t]+)?"
    r"(?P<data>[0-9a-f]{2}(?:[,; \t]?[0-9a-f]{2})*)(?:[,; \t]+[RT]|[ \t]+<.*)?[,;]*"
)
_CONSOLE: Final = "candump on a console"
_RELATIVE: Final = re.compile(
    r"^base\s+\w+\s+timestamps\s+relative|^\*\*\*RELATIVE MODE", _ANY | re.M
)
_DATE: Final = re.compile(
    r"^date +\w+ +(\w{3})\w* +(\d+) +([\d:.]+)( +[ap]m)? +(\d{4})", re.I | re.M
)
_ANEW: Final = re.compile(r"(?:date|base)\s|;\$STARTTIME=", re.I)  # another log in one file
_FIRST_LOG: Final = re.compile(r".*?^\s*\d+\.\d+\s.*?(?=^(?:date|base)\s|\Z)", _ANY | re.M | re.S)
_COLOURS: Final = re.compile("\x1b\\[[0-9;]*m")  # of candump -c
_HEADER_WITHIN: Final = 60  # lines of a table
_COUNT_S: Final = (1 << 32) / 1e6  # after which a sketch's micros() begins anew
_FRAMES_US: Final = (50.0, 250.0)  # least step of two frames, and of two with one identifier
_FROM_WHEN: Final = re.compile("abs(?:olute)?|rel(?:ative)?", re.I)  # in brackets, where a unit may
_CYCLE: Final = 3000.0  # an identifier comes oftener than every 3000 ms, and not every 3000 µs
_TIME: Final = re.compile(r"\s*(\d+\.\d+)\s")  # of any line of an .asc


def _layout(tool: str, begins: str, *rows: str, other: str = r"(?!)", **more: Any) -> TextLayout:
    """Return a layout; in the patterns of rows a blank stands for blanks, @name for a cell.

    begins : how a log begins, "" with any row
    """
    frames = [
        re.sub(r"@(\w+)", lambda cell: _CELLS[cell[1]], row.replace(" ", r"\s++")) for row in rows
    ]
    return TextLayout(
        tool=tool,
        begins=re.compile(begins or rf"^{frames[0]}$", _ANY | re.M),
        frames=tuple(re.compile(rf"\s*{row}\s*", _ANY) for row in frames),
        other=re.compile(other, _ANY),
        **more,
    )


def _saleae(lines: Iterator[str]) -> Iterator[str]:
    """Yield a line for each whole frame of Saleae's export: a row for each field, by analyzers."""
    frames = defaultdict[str, list[str]](list)
    for row in csv.DictReader(lines):
        try:
            frame = frames[row["name"]]
            if row["type"] == "identifier_field":
                remote = ["r"] * (row.get("remote_frame") == "true")
                frame[:] = row["start_time"], f"{int(row['identifier'], 0):X}", *remote
            elif row["type"] == "data_field":
                frame.append(f"{int(row['data'], 0):02X}")
            elif row["type"] == "crc_field":
                yield " ".join([*frame, "|", row["name"]])
            elif not row["type"]:
                raise ValueError
        except (KeyError, TypeError, ValueError):
            frames.clear()
            yield " ".join(map(str, row.values()))  # damaged


_CANDUMP_FRAME: Final = (  # its error frames have a flag in their identifier
    r"(?P<channel>\S+) "
    r"(?:(?P<error>[2367abef][0-9a-f]{7})#\S*|(?P<id>[0-9a-f]{1,3}|(?P<ext>[0-9a-f]{4,8}))#"
    r"(?:(?P<remote>r)\S*|(?:#\S?)?(?P<data>(?:[0-9a-f]{2}\.?)*)(?:_\S*)?))(?: .*)?"
)
CANDUMP: Final = _layout(
    "candump -L",
    r"\A\s*\(\d+\.\d+\) \S+ [0-9A-F]+#",
    rf"\((?P<time>-?[\d.]+(?:e[+-]?\d+)?)\) {_CANDUMP_FRAME}",
    time_s=float,
)
_ASC_DATA: Final = r"(?:d )?(?P<dlc>[0-9a-f]{1,2})(?P<data>(?: [0-9a-f]{1,3}\b(?!\s*=)){0,64})"
ASC: Final = _layout(  # CANalyzer's and CANoe's; frames, frames of CAN FD, error frames
    "Vector ASC",
    r"^(?:date +\w{2,3} +\w{3} +\d|base\s+(?:hex|dec)\b|begin trigger)",
    # names may stand in place of identifiers, which the end of the line tells
    rf"@time @channel \S+ (?:Rx|Tx|TxRq) {_ASC_DATA} .*\bID\s*=\s*(?P<id>(?P<dec>\d+))@ext?",
    rf"@time @channel @id@ext? (?:(?:Rx|Tx|TxRq) )?(?:@remote(?: \w+)?|{_ASC_DATA})"
    r"(?: \w+\s*=\s*\S+)*(?: //.*)?",
    r"@time (?P<fd>CANFD) @channel (?:Rx|Tx|TxRq) @id@ext? (?:\S*[^\s\d]\S* )?[01] [01] [0-9a-f]+ "
    r"@length@data(?:\s.*)?",
    r"@time (?:CANFD )?@channel (?:[RT]x )?(?P<error>ErrorFrame).*",
    # of a channel: a name that is no identifier behind its number
    other=r"\s*+(?:\d+\.\d+\s+(?:\d+\s+(?![0-9a-f]+x?\s|\S+\s+[RT]x\s+[dr]\s)[a-z_]|J1939TP\s|"
    r"\w+\s+Start of meas).*|(?!.*\s(?:Rx|Tx|TxRq)\s+[dr]\b)(?:[a-z]|//|\d+\.\d+\s+[a-z]).*)",
    ends_lines=True,
)
_NAMED: Final = _layout(
    "", "", rf"@time @channel (?P<name>[a-z_]\w*) (?:Rx|Tx|TxRq) {_ASC_DATA}(?:\s.*)?"
).frames
PEAK: Final = _layout(  # its columns stand in the header, see ``_peak``
    "PEAK TRC",
    r"^;\$FILEVERSION=|^;.*PCAN|^ *\d+\) +\d",
    other=r"\s*;(?!\s*\d{1,15}\)?\s+\d+(?:\.\d+)?\s).*|"
    r"\s*\d+\)?\s+[\d.]+\s+(?:\d+\s+)?(?:Warng|Error|ST|EC|ER|EV|FFFFFFFF)\b.*",
    time_s=lambda text: float(text) / 1e3,
    ends_lines=True,
)
_PEAK_COLUMNS: Final = {
    "1.1": "NOdILD",
    "1.2": "NOBdILD",
    "1.3": "NOBdIRLD",
    "2.0": "NOTIdlD",
    "2.1": "NOTBIdRLD",
}
_PEAK_CELLS: Final = {
    "N": r"\d{1,15}\)?",
    "O": r"(?P<time>-?\d+(?:\.\d+)?)",
    "B": r"(?P<channel>\d+)",
    "T": r"(?:DT|(?P<fd>FD|FB|FE|BI)|(?P<remote>RR))",
    "d": r"(?:Rx|Tx)",
    "R": r"\S+",
    "I": r"(?P<id>[0-9a-f]{1,4}|(?P<ext>[0-9a-f]{5,8}))",
    "L": r"(?P<dlc>\d{1,2})",
    "l": r"(?P<length>\d{1,2})",
    "D": r"(?:(?P<rtr>RTR)|(?P<data>[0-9a-f]{2}(?:\s+[0-9a-f]{2})*))",
}
CSV: Final = _layout(
    "python-can CSV",
    r"\Atimestamp,arbitration_id,extended,",
    r"(?P<time>-?[\d.]+(?:e[+-]?\d+)?),@id,(?:(?P<ext>1)|0),(?:(?P<remote>1)|0),"
    r"(?:(?P<error>1)|0),@length,(?P<base64>[\w+/=]*)",
    other=r"timestamp,arbitration_id,.*",
    ends_lines=True,
)
ROWS: Final = _layout(  # under no names; a clock, the digits or the steps tell the unit of time
    "rows of frames",
    rf"\A(?:{re.sub(r'[(][?]P<.*?>', '(?:', _ROW)}\s*(?:\n|\Z)){{2}}",
    _ROW,
    time_s=_told_s,
    wraps_s=_DAY_S,
)
LAYOUTS: Final = (
    _layout(
        _CONSOLE,
        r"^ *\([\d.: -]+\) +\S+ +(?:[RT]X [-B] [-E] +)?[0-9A-F]{3,8} +\[\d+\]"
        r"(?! +(?:[0-9A-F]{2}`|[01]{8}\b))|\A\s*\(\d+-[\d.: +TZ-]+\) +\S+ +[0-9A-F]+#",
        r"\((?P<time>[\d.:\s-]+)\) (?P<channel>\S+) (?:[RT]X [-B] [-E] )?"
        r"(?P<id>[0-9a-f]{3}|(?P<ext>[0-9a-f]{8})) \[@length\]\s*"
        r"(?:(?P<remote>remote request)|(?P<data>(?:\s?[0-9a-f]{2}\b)*))"
        r"\s*(?P<error>ERRORFRAME)?(?: '.*')?",
        rf"\((?P<time>\d+-[\d.:\s+TZ-]+)\) {_CANDUMP_FRAME}",  # of candump -L -tA
        other=r"[a-z-]+(?:\{.*)?|.*[$#>] ?candump.*|\^C.*",  # of error frames, of a shell
    ),
    _layout(
        "BusMaster",
        r"^\*\*\*BUSMASTER",
        r"@clock [RT]x @channel @id (?:s|@ext)(?:@remote|(?P<fd>-fd))? @length@data",
        r"@clock @channel (?P<id>(?P<ext>\w+)) 0x\w+ \w+ \w+ \w+ \d+ [RT]x "  # J1939
        r"(?P<length>[1-5]?\d|6[0-4])@data",  # longer groups are of several frames
        other=r"\*\*\*.*|.*\bERR\b.*|[\d:]+\s+\d+\s+\w+\s+0x.*",
        wraps_s=_DAY_S,
    ),
    _layout(
        "CanHacker",
        r"^\s*Time\s+ID\s+DLC\s+Data\b",
        r"@time (?P<id>[0-9a-f]{1,3}|(?P<ext>[0-9a-f]{4,8})) @length"
        r"(?: (?P<remote>RTR)|(?P<data>(?: [0-9a-f]{2}\b)*))(?:\s.*)?",
        other=r"\s*Time\s+ID\s+DLC.*",
    ),
    _layout(  # of CanKing, and of the Memorator as its converter writes it
        "Kvaser",
        r"^\s*(?:Chn|Time\s+Chan)\s+Identifier\s+Fla?g",
        r"@channel @id (?P<flags>(?:[a-wyz]|@ext)*)\s*@length@data @time [RT]",
        r"@time @channel @id@ext? (?:(?:Rx|Tx|TxRq) )?(?:[EBPW#]|(?P<fd>F)|(?P<remote>R)|\s)*"
        r"(?P<dlc>\d+)(?:@data| RTR) \d+",
        other=r"\s*(?:[a-z]|-+|=+).*|.*(?:ErrorFrame|Trigger \().*",
    ),
    _layout(
        "CRTD (OVMS)",
        r"^\d+\.\d+ \d*(?:C[A-Z]{2}\b|[RT](?:11|29) )",
        r"@time (?P<channel>\d*)[RT](?:11|(?P<ext>29)) @id@data",
        other=r"\d+\.\d+\s+\d*C[A-Z]{2}\b.*",
    ),
    _layout(
        "Microchip CAN BUS Analyzer",
        r"Microchip Technology|^CAN BUS Analyzer",
        r"@time;[RT]X;@id;@length@data[;\s]*",
        other=r"[^;]*",
        time_s=_counted_s,
    ),
    _layout(
        "labelled frames",  # as sketches for microcontrollers print them
        "",
        r"\W{0,9}(?:t\w*\W+)?@moment\b(?!\s*[uµ]s\b).{0,40}?\bid\W+@id\b.{0,40}?"
        r"\b(?:dlc|len\w*)\W+@length\b.{0,20}?\bdata\W*(?P<data>(?:(?:\s|0x)*[0-9a-f]{2}\b){1,64})\W{0,9}",
        other=r"\D*",
        time_s=_counted_s,
        wraps_s=_DAY_S,
    ),
    _layout(
        "python-can",
        r"^.{0,60}\bTimestamp: +\d+\.\d+ +ID: ",  # printed, logged, and data sets of intrusions
        r".{0,60}\bTimestamp: @time ID: @short(?: (?:(?P<remote>R)|(?P<error>E)|\w+))* DLC?: "
        r"@length@data(?: (?:.*Channel: (?P<channel>\S+))?.*)?",
    ),
    _layout(
        "GVRET on its serial line",
        "",
        r"(?P<time>\d+) - @id (?:S|(?P<ext>X)) @channel @length@data",
        time_s=lambda text: int(text) / 1e6,
        wraps_s=_COUNT_S,
    ),
    _layout(
        "CARBUS Analyzer",
        r"\A@ TEXT @",
        r"@time @channel [0-9a-f]{8} @short @length@data(?:\t.*)?",
        other=r"[@#].*",
    ),
    _layout(
        "socketcand",
        r"^< (?:hi|ok|frame\b.*) >",
        r"< frame @short @time (?P<data>[0-9a-f\s]*)>",
        other=r"<.*>",
    ),
    _layout(
        "CANwise",
        r"^EV +NUM/ERR ",
        r"[RT]X \d+ (?:SFF|(?P<ext>EFF)) @id @length HEX@data (?P<time>\d{10}) .*",
        other=r"E.*",
        time_s=lambda text: int(text) / 1e6,
    ),
    _layout(
        "Saleae Logic",
        r'\A"?name"?,"?type"?,"?start_time',
        r"(?P<time>[\d.e-]+) @id(?: @remote)?@data \| (?P<channel>.*)",
        joined=_saleae,
    ),
    ROWS,
    CSV,
    PEAK,
    ASC,
)
TABLE: Final = _layout(  # of SavvyCAN, Kvaser, CANedge, IXXAT, Vehicle Spy, …, see ``_table``
    "a table of frames", r"(?!)", other=r"[\s\"]*[a-z,#%\u0080-\uffff].*", wraps_s=_DAY_S
)
_REST: Final = r'(?:"[^"]*"|[^{sep}]*+)'  # a cell; {sep} parts them
_ALL_BYTES: Final = (  # of a list with commas, too
    r"(?:x\|)? *\[?(?P<data>(?<=\[)[0-9a-fx, ]*+|[0-9a-fx: -]*+)\]?"
)
_YES: Final = r"true|t|1|x|ext\w*|扩展帧"
_OF: Final = r"(?:(?:can|arb\w*|frame|m\w*g\w*)[ _-]?)?"
_TABLE_COLUMNS: Final = (  # the name of a column, and its cells with the groups of ``TextLayout``
    (
        r"(?!.*(?:delta|cycle|diff|interval|period|since[ _](?:last|prev)|zyklus))"
        r"(?:(?:abs|start|rx|(?!rel)\w+[ _])?(?:time|zeit).*|offset.*|ts|milli\w*|micro\w*|seconds|"
        "系统时间|时间标识|时间)",
        r'(?P<time>-?\d+(?:(?!{sep})[.,]\d*)?|[^{sep}"]*(?:\d:\d|\d\dT\d{6})[^{sep}"]*+)',
    ),
    (
        rf"{_OF}(?:id|identifier|addr\w*)(?:_...)?\b.*|帧?id号?",
        r"(?P<id>(?:0x)?[0-9a-f]{1,9})[hx]?",
    ),
    (
        r"(?:can[ _-]?)?(?:bus|channel|chan|chn?|kanal|interface|iface|network|net)"
        r"(?:[ _]?(?:channel|id|no|nr|num\w*))?\.?|(?:can)?通道号?",
        r"(?P<channel>[^{sep}]*+)",
    ),
    (r"can|device|(?:can[ _-]?)?port\b.*", r"(?P<channel>[^{sep}]*+)"),  # where none is above
    (rf"{_OF}(?:data ?)?len(?:gth)?|size|dlc|(?:数据)?长度", r"(?:0x)?(?P<length>\d*)"),
    (r"(?:is[_ ]?)?ext\w*|ide|xtd|format|frame|帧格式", rf"(?:(?P<ext>{_YES})|{_REST})"),
    (r"(?:is[_ ]?)?(?:remote|rtr)", rf"(?:(?P<remote>t|1|true|rem\w*)|{_REST})"),
    (r"er|(?:is[_ ]?)?err\w*", rf"(?:(?P<error>{_YES})|{_REST})"),
    (  # in words, of which several may stand in a cell
        rf"(?:id[ _]?|{_OF})(?:type|format)|帧类型",
        r"(?:(?=[^{sep}]*(?P<remote>\brem|rtr|远程帧))|)(?:(?=[^{sep}]*(?P<error>\berr))|)"
        rf"(?:(?=[^{{sep}}]*(?P<ext>\bext|xtd|29.?bit))|){_REST}",
    ),
    (r"flags?", r'(?P<flags>[^{sep}"]*+)'),
    (
        rf"{_OF}(?:data|daten|payload)(?:[ _]?bytes?)?(?:[ _]?[(\[]?hex[)\]]?)?|"
        r"数据(?:\(hex\))?",
        _ALL_BYTES,
    ),
    (
        r"(?:data|byte|d|b)[ _]?[01]",
        r"(?P<data>(?:0x)?[0-9a-f]{0,3}(?:{sep} *+(?:0x)?[0-9a-f]{0,3} *+){0,{further}})",
    ),
    ("message", _ALL_BYTES),  # elsewhere a name
)
_WITH_PART: Final = (r"[,;\t]", r"(?P<time>(?:\d+-\d+-\d+[ T])?[\d:]+{sep} *+\d{1,9})")
_BYTE: Final = re.compile(r"(?:data|byte|d|b)[ _]?(\d+)")
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
    names: Mapping[str, int] = {}  # keys of frames by what stands in place of their identifiers


def layout_of(path: Path, kind: str = "", names: Mapping[str, int] | None = None) -> LayoutFound:
    """Return the layout of a text log by its first lines, else by its suffix ``kind``.

    names : keys of frames by the names of their messages
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
        if re.search(each["begins"], text, _ANY | re.M):
            told = f"a CAN log, {each['is']}: not read, convert it with {each['converter']}"
            raise RecordingError(told)
    layout = layout or {".asc": ASC, ".trc": PEAK, ".log": CANDUMP}.get(kind)
    if layout is PEAK:
        return _peak(text, encoding)
    if layout is not None:
        start_s = _start_s(text)
        text = (_FIRST_LOG.match(text) or [text])[0]
        layout = _asc(text, names or {}) if layout is ASC else layout
        rows = list(filter(None, map(layout.match, text.splitlines())))
        if rows and ":" in rows[0]["time"] and layout.tool != TABLE.tool:
            layout = replace(layout, time_s=ColumnClock())
        says_decimal = re.search(r"\*\*\*DEC\*\*\*|^base\s+dec|data field: DEC", text, _ANY | re.M)
        base = 10 if says_decimal or _is_decimal(layout, rows) else 16
        fd = " ".join(row["data"] for row in rows if row.groupdict().get("fd"))
        fd_base = 16 if re.search("[a-f]", fd, re.I) else base  # CANoe's, beside decimal ones
        deltas = _are_deltas(layout, rows, text)
        return LayoutFound(layout, encoding, base, deltas, start_s, fd_base, names or {})
    return LayoutFound(encoding=encoding)


def _known(text: str) -> TextLayout | None:
    """Return the layout that the first lines tell, None if it is none that is read."""
    layout = next((each for each in LAYOUTS if each.begins.search(text)), None)
    if layout is not ROWS:
        return layout or _table(text)
    rows = list(filter(None, map(ROWS.match, text.splitlines())))
    times = [row["time"] for row in rows]
    told = "".join((row["dlc"] or "") + (row["length"] or "") for row in rows)
    if not told and not re.search("[a-fx]", "".join(row["id"] + row["data"] for row in rows), re.I):
        return None  # numbers of any kind
    if not all(map(str.isdigit, times)) or len(times[0]) > 12:  # with a point, or since 1970
        return ROWS
    steps = {int(b) - int(a) for a, b in pairwise(times)}
    if min(steps) < 0 or max(steps) <= 1:  # a channel, or a counter of rows
        return None
    return replace(ROWS, **_times("time", times, len({row["id"] for row in rows})))


def _asc(text: str, names: Mapping[str, int]) -> TextLayout:
    """Return Vector's layout; names in place of identifiers are tried first where a line has one.

    Raises RecordingError for names alone, none of which is among ``names``.
    """
    lines, (named, *numbered) = text.splitlines(), ASC.frames
    frames = ASC.frames if any(map(named.fullmatch, lines)) else (*numbered, named)
    has_ids = any(each.fullmatch(line) for line in lines for each in frames)
    said = [row["name"] for row in map(_NAMED[0].fullmatch, lines) if row and not has_ids]
    if said and names.keys().isdisjoint(said):
        raise RecordingError(
            "its frames have names in place of identifiers, which no database that is given knows: "
            "write it with numbers (CANoe's numeric display, not the symbolic one)"
        )
    return replace(ASC, frames=_NAMED if said else (*frames, *(_NAMED if names else ())))


def _peak(text: str, encoding: str) -> LayoutFound:
    """Return PEAK's layout with the columns and the start that its header tells."""
    version, columns = (
        found[1] if (found := re.search(rf"^;\${name}=([\w.,]+)", text, _ANY | re.M)) else ""
        for name in ("FILEVERSION", "COLUMNS")
    )
    letters = columns.replace(",", "") or _PEAK_COLUMNS.get(version, "NOILD")
    cells = [_PEAK_CELLS.get(each, r"\S+") for each in letters]
    pattern = r"\s*" + r"\s+".join(cells[:-1]) + r"(?:\s+" + cells[-1] + r")?\s*"
    layout = replace(PEAK, frames=(re.compile(pattern, _ANY),))
    return LayoutFound(layout, encoding, start_s=_start_s(text))


def _begun_anew(line: str, found: LayoutFound) -> LayoutFound:
    """Return what a line of a header changes."""
    if line.lower().startswith("base"):
        base = 10 if re.match(r"base\s+dec", line, _ANY) else 16
        return found._replace(base=base, deltas=bool(_RELATIVE.search(line)))
    return found._replace(start_s=_start_s(line) or found.start_s)


def _start_s(text: str) -> float:
    """Return the time of PEAK's or Vector's header, English or German, since 1970; 0 for none."""
    if days := re.search(r"^;\$STARTTIME=([\d.]+)", text, _ANY | re.M):
        return (_PEAK_EPOCH + timedelta(days=float(days[1]))).timestamp()
    date = _DATE.search(text)
    start_s = clock("{1}-{0}-{4} {2}{3}".format(*date.groups(""))) if date else 0.0
    return start_s if start_s > _DAY_S else 0.0


def _table(text: str) -> TextLayout | None:
    """Return the layout of a table of frames by the names of its columns, None if it is none."""
    lines = text.splitlines()[:_HEADER_WITHIN]
    for number, line in enumerate(lines):
        below = lines[number + 1 :]
        for sep in ",;\t" if re.search("id|addr", line, re.I) else "":
            told = [name.strip(' "%') for name in line.split(sep)]  # CAN_DataFrame.ID, can.id
            every = [re.sub(r".*\.(?=[a-z_]\w*$)", "", name.casefold()) for name in told]
            clock_alone = ["" if name.startswith("time") else name for name in every]
            for names in every, clock_alone:  # the adapter's time may be a hexadecimal count
                pattern = _table_row(names, sep)
                if pattern and (rows := [*filter(None, map(pattern.fullmatch, below))]):
                    ids = {row["id"] for row in rows}
                    time, can_id = (_place(form, names) for form, _ in _TABLE_COLUMNS[:2])
                    layout = replace(TABLE, id_base=_id_base(told[can_id], ids))
                    if joined := _joined(names, time, sep, below):
                        return replace(layout, frames=joined[:1], time_s=joined[1])
                    times = _times(names[time], [row["time"] for row in rows], len(ids))
                    return replace(layout, frames=(pattern,), **times)
    return None


def _joined(
    names: Sequence[str], time: int, sep: str, lines: Sequence[str]
) -> tuple[re.Pattern[str], Callable[[str], float]] | None:
    """Return pattern and time of rows with whole seconds, or a clock, and a part of them behind.

    None if the column behind the time's holds no parts of a second alone.
    """
    part = unit_of(names[time + 1], 1.0) if time + 1 < len(names) else None
    pattern = _table_row([*names[:time], sep, *names[time + 2 :]], sep)
    if not (pattern and part and part.quantity == "time" and part.factor < 1.0):
        return None
    clock_s = ColumnClock()

    def time_s(text: str) -> float:
        whole, _, rest = text.rpartition(sep)
        return (clock_s(whole) if ":" in whole else float(whole)) + int(rest) * part.factor

    parts = [row["time"].rpartition(sep)[2] for row in map(pattern.fullmatch, lines) if row]
    return (pattern, time_s) if parts and max(map(int, parts)) * part.factor < 1.0 else None


def _table_row(names: Sequence[str], sep: str) -> re.Pattern[str] | None:
    """Return the pattern of a row of frames; None if time, identifier or data lack."""
    cells = [_REST] * len(names)
    for form, cell in (_WITH_PART, *_TABLE_COLUMNS):
        place, taken = _place(form, names), re.findall(r"\?P<(\w+)>", "".join(cells))
        if place >= 0 and cells[place] == _REST and not ("<data>" in cell and "data" in taken):
            known = "|".join(taken) or r"\Z"
            cells[place] = re.sub(rf"\?P<(?:{known})>", "?:", cell)
    cells = cells[: next((i + 1 for i, cell in enumerate(cells) if "further" in cell), len(cells))]
    numbers = [int(n[1]) for n in map(_BYTE.fullmatch, names) if n]
    if numbers != sorted(numbers):  # the last byte first
        return None
    body = rf'"? *+{sep} *+=?"?'.join(cells).replace("{sep}", sep)
    body = body.replace("{further}", str(len(numbers) - 1))
    has_all = all(f"<{group}>" in body for group in ("time", "id", "data"))
    return re.compile(rf'=?"?{body} *+"?(?:{sep}.*)?', _ANY) if has_all else None


def _place(form: str, names: Sequence[str]) -> int:
    """Return the place of the column whose name fits, hexadecimal rather than decimal; or -1.

    Others are of a header, or of the computer.
    """
    fitting = [
        ("hex" not in n or "time" in n, n != "id", not n.startswith("time"), i)
        for i, n in enumerate(names)
        if re.fullmatch(form, n)
    ]
    return min(fitting, default=(-1,))[-1]


def _times(named: str, times: Sequence[str], n_ids: int) -> dict[str, Any]:
    """Return the way to seconds, and when the count begins anew, as fields of ``TextLayout``.

    The unit of the column ``named`` tells it, else digits and identifiers.
    """
    is_clock = any(mark in time for time in times for mark in ":Tt")
    values = list(map(ColumnClock() if is_clock else _seconds, times))
    steps = [b - a for a, b in pairwise(values)]
    falls, rises = [-step for step in steps if step < 0.0], [s for s in steps if s > 0.0]
    if 3 * len(falls) > 1 + len(rises) and 2.0 * sum(falls) > sum(rises):
        raise RecordingError(f"its {named} falls from row to row: rising times are wanted")
    if is_clock:
        return {"time_s": ColumnClock()}
    said = named.rpartition("_")[2]
    stated = _FROM_WHEN.sub("", name_and_unit(named)[1])
    unit = unit_of(stated or said, 1.0)
    step = (max(values) - min(values)) / max(1, len(values) - 1)
    if unit and unit.quantity == "time":
        step_s = unit.factor
    elif values[0] > 1e12:  # since 1970
        return {"time_s": _told_s}
    elif any(mark in time for time in times for mark in ".,"):
        is_fine = any(re.search(r"[.,]\d{4}", time) for time in times)  # no ms are as fine
        step_s = 1.0 if step < 1.0 or is_fine else 1e-3
    elif stated:
        raise RecordingError(f"its column {named} counts in an unknown unit: call it time_us, …")
    elif _FRAMES_US[1] <= step * n_ids < _CYCLE and min(filter(None, steps)) >= _FRAMES_US[0]:
        raise RecordingError(f"its {named} may be in ms or µs: call it time_ms or time_us")
    else:
        step_s = 1e-6 if step * n_ids >= _CYCLE else 1e-3
    wraps_s = _COUNT_S if step_s == 1e-6 else _DAY_S
    return {"time_s": lambda text: _seconds(text) * step_s, "wraps_s": wraps_s}


def _id_base(named: str, ids: set[str]) -> int:
    """Return the base of identifiers, 0 if nothing tells it: 10 by the tool, or by large ones.

    named : the name of their column
    """
    if not "".join(ids).isdecimal() or re.search("hex", named, re.I):
        return 16
    is_large = any(int(each, 16) >> 29 or re.fullmatch("1...|20[0-4].", each) for each in ids)
    is_said = re.search(r"\b(can\.id|addr|arb\w*_id)\b|[ _(]dec", named, re.I)
    return 10 if is_large or is_said else 0


def _is_decimal(layout: TextLayout, rows: Sequence[re.Match[str]]) -> bool:
    """Return whether bytes are decimal: of three digits, no letters; or of one as identifiers."""
    if not layout.tool.startswith("Kvaser") and layout.tool != TABLE.tool:
        return False
    is_hex = layout.id_base == 16
    data = [row["data"] or "" for row in rows]
    ids = [row["id"] for row in rows if not is_hex]
    letters = re.search("[a-fx]", " ".join([*data, *ids]), re.I)
    lengths = {len(byte) for row in data for byte in re.split(r"[\s,;]+", row)}
    return not letters and (3 in lengths or (1 in lengths and not is_hex))


def _are_deltas(layout: TextLayout, rows: Sequence[re.Match[str]], text: str) -> bool:
    """Return whether times are those since the line before: Vector's and BusMaster's header say so.

    Those of candump -td begin with 0, as with -tz, fall often and the later ones are no larger.
    """
    if layout.tool not in (_CONSOLE, CANDUMP.tool):
        return bool(_RELATIVE.search(text))
    times_s = [layout.time_s(row["time"]) for row in rows]
    middle = (len(times_s) + 1) // 2
    rises, falls = (sum(map(is_so, times_s, times_s[1:])) for is_so in (lt, gt))
    if times_s[:1] != [0.0] or rises > 2 * falls + 1:
        return False
    return median(times_s[middle:] or [1.0]) <= max(times_s[:middle])


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
            if (match := layout.match(line)) is None:
                line = line.lstrip()  # of a table's row the first cells may be empty
                if not layout.other.fullmatch(line):
                    raise ValueError(line)
                if found.deltas and (time := _TIME.match(line)):
                    before_s += float(time[1])
                elif counters.frames and _ANEW.match(line):
                    found, before_s, late_s = _begun_anew(line, found), 0.0, 0.0
                continue
            time_s = layout.time_s(match["time"]) + (before_s if found.deltas else 0.0)
            if time_s + late_s < before_s - layout.wraps_s / 2:
                late_s += layout.wraps_s
            before_s = time_s + late_s
            groups = match.groupdict()
            frame = _frame(groups, before_s, found)
            channel = groups.get("channel") or ""
        except (ValueError, IndexError):
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
    if (match := CANDUMP.match(line)) is None:
        raise ValueError("not a candump line")
    return _frame(match.groupdict(), float(match["time"]), LayoutFound(CANDUMP))


def _frame(groups: dict[str, str | None], time_s: float, found: LayoutFound) -> Frame | None:
    """Return the frame of a line's groups, None for a remote or error frame."""
    flags = groups.get("flags") or ""
    bits = int(flags) if flags.isdecimal() else 0  # of Kvaser
    if bits & _KVASER_NO_DATA or any(map(groups.get, ("remote", "error", "rtr"))):
        return None
    assert found.layout
    base = found.fd_base if groups.get("fd") else found.base
    if name := groups.get("name"):
        if (key := found.names.get(name)) is None:  # a message that nobody asked for
            return None
        can_id, is_extended = key & ~EXTENDED, key >= EXTENDED
    else:
        can_id = int(groups["id"] or "", 10 if groups.get("dec") else found.layout.id_base or base)
        is_extended = bool(groups.get("ext") or bits & _KVASER_EXTENDED) or can_id > _STANDARD
    data = _data(groups, base)
    late_s = found.start_s + time_s
    if len(data) > MAX_BYTES or not abs(late_s) < LATEST_S or can_id >> 29:
        raise ValueError("no CAN frame")
    t_us = round(found.start_s * 1e6) + round(time_s * 1e6)
    return Frame(t_us * 1000, can_id, is_extended, data)


def _data(groups: dict[str, str | None], base: int) -> bytes:
    """Return the data, as many bytes as the line says; raises ValueError if some lack."""
    code = groups.get("dlc") or ""
    length = int(code or groups.get("length") or "-1", 16 if len(code) == 1 else 10)
    if (packed := groups.get("base64")) is not None:
        data = b64decode(packed, validate=True)
    else:
        raw = groups.get("data") or ""
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
