"""CAN logs that other tools write as text: a pattern for each tool.

A layout says how a log of the tool begins, what a line with a frame looks like, and which lines are
none. Sources: the tools' documentation and logs, and the formats that SavvyCAN reads.
"""

import csv
import math
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

ANY: Final = re.IGNORECASE | re.ASCII
COUNT_S: Final = (1 << 32) / 1e6  # after which a sketch's micros() begins anew

Groups = Mapping[str, str]  # parts of a line with a frame, "" for none


def counted_s(text: str) -> float:
    """Return a number of seconds; whole ones are of ms, of 16 digits µs, of 19 ns."""
    text = text.replace(",", ".")
    whole, point, _ = text.partition(".")
    return float(text) * 1e-3 ** max(not point, (len(whole) - 10) // 3)


def seconds(text: str) -> float:
    """Return a number of seconds; a decimal comma counts."""
    return float(text.replace(",", "."))


def told_s(text: str) -> float:
    """Return a number of seconds; 13 digits before its point and more are of ms, µs or ns."""
    return seconds(text) * 1e-3 ** max(0, (len(re.split("[.,]", text)[0]) - 10) // 3)


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
    row: Callable[[str], Groups | None] | None = None  # of a table, in place of ``frames``
    time_s: Callable[[str], float] = seconds
    id_base: int = 0  # of identifiers, 0 that of the data
    wraps_s: float = math.inf  # after which a counter begins anew
    ends_lines: bool = False  # with a line end, the last one, too
    joined: Callable[[Iterator[str]], Iterator[str]] = iter  # lines of frames from those of a file

    def groups(self, line: str) -> Groups | None:
        """Return the parts of a line with a frame, None for any other line."""
        if self.row:
            return self.row(line)
        match = next(filter(None, (frame.fullmatch(line) for frame in self.frames)), None)
        return match.groupdict("") if match else None


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


def _layout(tool: str, begins: str, *rows: str, other: str = r"(?!)", **more: Any) -> TextLayout:
    """Return a layout; in the patterns of rows a blank stands for blanks, @name for a cell.

    begins : how a log begins, "" with any row
    """
    frames = [
        re.sub(r"@(\w+)", lambda cell: _CELLS[cell[1]], row.replace(" ", r"\s++")) for row in rows
    ]
    return TextLayout(
        tool=tool,
        begins=re.compile(begins or rf"^{frames[0]}$", ANY | re.M),
        frames=tuple(re.compile(rf"\s*{row}\s*", ANY) for row in frames),
        other=re.compile(other, ANY),
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
_ASC_DATA: Final = r"(?:d )?(?P<dlc>[0-9a-f]{1,2})(?P<data>(?: [0-9a-f]{1,3}\b(?!\s*=)){0,64}+)"
ASC: Final = _layout(  # CANalyzer's and CANoe's; frames, frames of CAN FD, error frames
    "Vector ASC",
    r"^(?:date +\w{2,3} +\w{3} +\d|base\s+(?:hex|dec)\b|begin trigger)",
    # names may stand in place of identifiers, which the end of the line tells
    r"@time @channel (?:@id@ext? (?:(?:Rx|Tx|TxRq) )?|\S+ (?:Rx|Tx|TxRq) )"
    rf"(?:@remote(?: \w+)?|{_ASC_DATA})(?: (?!ID\b)\w+\s*=\s*\S+)*+"
    r"(?: ID\s*=\s*(?P<dec>\d+)(?P<dec_ext>x)?(?:\s.*)?)?(?: //.*)?",
    r"@time (?P<fd>CANFD) @channel (?:Rx|Tx|TxRq) @id@ext? (?:\S*[^\s\d]\S* )?[01] [01] [0-9a-f]+ "
    r"@length@data(?:\s.*)?",
    r"@time (?:CANFD )?@channel (?:[RT]x )?(?P<error>ErrorFrame).*",
    # of a channel: a name that is no identifier behind its number
    other=r"\s*+(?:\d+\.\d+\s+(?:\d+\s+(?![0-9a-f]+x?\s|\S+\s+[RT]x\s+[dr]\s)[a-z_]|J1939TP\s|"
    r"\w+\s+Start of meas).*|(?!.*\s(?:Rx|Tx|TxRq)\s+[dr]\b)(?:[a-z]|//|\d+\.\d+\s+[a-z]).*)",
    ends_lines=True,
)
PEAK: Final = _layout(  # its columns stand in the header, see ``peak``
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
ROWS: Final = _layout(  # under no names; a clock, the digits or the steps tell the unit of time
    "rows of frames",
    rf"\A(?:{re.sub(r'[(][?]P<.*?>', '(?:', _ROW)}\s*(?:\n|\Z)){{2}}",
    _ROW,
    time_s=told_s,
)
TABLE: Final = _layout(  # of SavvyCAN, Kvaser, CANedge, IXXAT, Vehicle Spy, …, see ``frame_table``
    "a table of frames", r"(?!)", other=r"[\s\"]*[a-z,#%\u0080-\uffff].*"
)
CONSOLE: Final = "candump on a console"
LAYOUTS: Final = (
    _layout(
        CONSOLE,
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
        time_s=counted_s,
    ),
    _layout(
        "labelled frames",  # as sketches for microcontrollers print them
        "",
        r"\W{0,9}(?:t\w*\W+)?@moment\b(?!\s*[uµ]s\b).{0,40}?\bid\W+@id\b.{0,40}?"
        r"\b(?:dlc|len\w*)\W+@length\b.{0,20}?\bdata\W*(?P<data>(?:(?:\s|0x)*[0-9a-f]{2}\b){1,64})\W{0,9}",
        other=r"\D*",
        time_s=counted_s,
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
        wraps_s=COUNT_S,
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
    _layout(
        "python-can CSV",
        r"\Atimestamp,arbitration_id,extended,",
        r"(?P<time>-?[\d.]+(?:e[+-]?\d+)?),@id,(?:(?P<ext>1)|0),(?:(?P<remote>1)|0),"
        r"(?:(?P<error>1)|0),@length,(?P<base64>[\w+/=]*)",
        other=r"timestamp,arbitration_id,.*",
        ends_lines=True,
    ),
    PEAK,
    ASC,
)


def peak(text: str) -> TextLayout:
    """Return PEAK's layout with the columns that its header tells."""
    version, columns = (
        found[1] if (found := re.search(rf"^;\${name}=([\w.,]+)", text, ANY | re.M)) else ""
        for name in ("FILEVERSION", "COLUMNS")
    )
    letters = columns.replace(",", "") or _PEAK_COLUMNS.get(version, "NOILD")
    *cells, data = [_PEAK_CELLS.get(each, r"\S+") for each in letters]
    pattern = r"\s*" + r"\s+".join(cells) + rf"(?:\s+{data})?\s*"
    return replace(PEAK, frames=(re.compile(pattern, ANY),))
