"""Lines of ``.asc`` and ``.trc`` logs that python-can's readers would leave out without a word.

They skip a line that they cannot read, and ignore what follows a frame on its line. In a damaged
log thousands of frames may be lost so, and their absence looks like a bus that fell silent. Here
such a line is counted, as it is in a candump log. Events that are no frames pass: statistics,
error frames, bus states, comments, messages of other buses. Of an ``.asc`` whose header ends
without a line on internal events, python-can loses the first frame: the reader is given that line.

python-can also takes the times of every ``.asc`` for those since the beginning. In a log that says
``timestamps relative`` a time is that since the line before; its lines are returned with the sum.
"""

import re
from collections.abc import Callable, Iterator
from decimal import Decimal
from typing import Final, TextIO

from monitor.frames.blocks import LogCounters
from monitor.frames.text.lines import CUT_SHORT

_CSV_HEADER: Final = "timestamp,arbitration_id,"
_CSV_FRAME: Final = re.compile(r"-?[\d.]+(?:e[+-]?\d+)?,0x[0-9a-f]+(?:,[01]){3},\d+,[\w+/=]*", re.I)
_ASC_FRAME: Final = re.compile(
    r"\d+\.\d+\s+\d+\s+\w+\s+(?:Rx|Tx|TxRq)\s+"
    r"(?:r(?:\s+\w+)?|d\s+[0-9a-f]{1,2}(?:\s+[0-9a-f]{1,3}\b(?!\s*=))*)"
    r"(?:\s+\w+\s*=\s*\S+)*",
    re.IGNORECASE,
)
_ASC_FD: Final = re.compile(r"\d+\.\d+\s+CANFD\s+\d+\s+(?:Rx|Tx|TxRq)\s", re.IGNORECASE)
_ASC_EVENT: Final = re.compile(  # of a channel: a name that is no identifier behind its number
    r"\d+\.\d+\s+(?:\d+\s+(?![0-9a-f]+x?\s)[a-z_]|J1939TP\s|\w+\s+Start of measurement)",
    re.IGNORECASE,
)
_ASC_START: Final = re.compile(r"\s*\d+\.\d+\s+\w+\s+Start of measurement", re.IGNORECASE)
_ASC_HEADER_END: Final = "no internal events logged\n"
_ASC_DIRECTION: Final = re.compile(r"\s(?:Rx|Tx|TxRq)\s+[dr]\b", re.IGNORECASE)  # of a frame
_ASC_RELATIVE: Final = re.compile(r"base\s+\w+\s+timestamps\s+relative", re.IGNORECASE)
_ASC_TIME: Final = re.compile(r"\s*(\d+\.\d+)(?=\s)")
_ASC_OTHER: Final = re.compile(r"[a-z]|//|\d+\.\d+\s+[a-z]", re.IGNORECASE)  # header or event
_TRC_FRAME: Final = re.compile(  # behind its number
    r"-?\d+(?:\.\d+)?\s+(?:\S+\s+){1,6}?\d{1,2}"
    r"(?:\s+RTR|(?:\s+[0-9a-f]{2})*)",
    re.IGNORECASE,
)
_TRC_TYPES: Final = {"Rx", "Tx", "Warng", "Error"}  # of the versions 1.1 and 1.3
_TRC_TYPES_2: Final = {"DT", "FD", "FB", "FE", "BI", "RR", "ST", "EC", "ER", "EV"}
_TRC_EVENTS: Final = {"Warng", "Error", "ST", "EC", "ER", "EV"}
_TRC_NUMBER: Final = re.compile(r"\d{1,15}\)?")  # of a message, at the beginning of its line
_TRC_LEAST: Final = 4  # number, time, identifier and length


class FrameLines:
    """A text log whose lines are checked as they are read.

    kind : ".asc", ".csv" or ".trc"
    counters : counts damaged lines
    """

    def __init__(self, file: TextIO, kind: str, counters: LogCounters) -> None:
        self._file = file
        checks = {".asc": _is_asc, ".trc": _Trc().is_line, ".csv": _is_csv}
        self._check: Callable[[str], bool] = checks.get(kind, bool)
        self._begin = _CSV_HEADER if kind == ".csv" else ""
        self._times = _AscTimes() if kind == ".asc" else None
        self._number, self._counters = 0, counters
        self._header_end = _ASC_HEADER_END if kind == ".asc" else ""
        self._held = ""  # the first frame's line, behind the end of the header
        self.cut = ""  # why the log ends too early

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        """Return the next whole line; raises ValueError if too many are damaged."""
        if self._held:
            line, self._held = self._held, ""
            return line
        for line in self._file:
            self._number += 1
            if self._number == 1 and not line.startswith(self._begin):
                first = line.strip()[:40]
                raise ValueError(f"its first line is {first!r}, python-can's log header is wanted")
            if not line.endswith(("\n", "\r")):
                self.cut = CUT_SHORT
                break
            if not self._check(line):
                self._counters.leave_out(self._number, line, "a frame or an event is wanted")
                continue
            good = self._times.since_beginning(line) if self._times else line
            if _ASC_START.match(line):  # python-can takes that of CAN FD for a frame
                good = "//\n"
            if self._header_end and _ASC_TIME.match(good):
                self._held, good, self._header_end = good, self._header_end, ""
            return good
        raise StopIteration

    def read(self, size: int = -1) -> str:
        """Return text as it stands in the file."""
        return self._file.read(size)

    def write(self, text: str) -> int:
        """Write nothing; python-can takes what can write for a file."""
        raise OSError("a log that is read")

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _is_asc(line: str) -> bool:
    line = line.strip()
    if _ASC_FRAME.fullmatch(line):
        return True
    if _ASC_FD.match(line) or _ASC_EVENT.match(line):
        return True
    return not line or bool(_ASC_OTHER.match(line) and not _ASC_DIRECTION.search(line))


def _is_csv(line: str) -> bool:
    return line.startswith(_CSV_HEADER) or bool(_CSV_FRAME.fullmatch(line.strip()))


class _AscTimes:
    """Adds up the times of a log whose times are those since the line before."""

    def __init__(self) -> None:
        self._are_relative = False
        self._now_s = Decimal(0)

    def since_beginning(self, line: str) -> str:
        """Return the line with its time since the beginning of the log."""
        if not self._are_relative:
            self._are_relative = _ASC_RELATIVE.match(line) is not None
            return line
        time = _ASC_TIME.match(line)
        if time is None:
            return line
        self._now_s += Decimal(time[1])
        return f"{self._now_s}{line[time.end() :]}"


class _Trc:
    """Knows the version of a ``.trc`` log from its header."""

    _all_types: Final = _TRC_TYPES | _TRC_TYPES_2

    def __init__(self) -> None:
        self._types: set[str] | None = None  # version 1.0 has none
        self._is_numbered = True
        self._has_begun = False  # frames came; before them the header names columns as they do

    def is_line(self, line: str) -> bool:
        """Return whether a line is a comment or whole."""
        line = line.strip()
        if line.startswith(";$FILEVERSION"):
            version = line.partition("=")[2]
            self._types = _TRC_TYPES_2 if version.startswith("2") else _TRC_TYPES
        if line.startswith(";$COLUMNS"):
            self._is_numbered = line.partition("=")[2].startswith("N")
        cells = line.split()
        if not line or line.startswith(";"):
            holds_frame = len(cells) > _TRC_LEAST and not self._all_types.isdisjoint(cells)
            return not (self._has_begun and holds_frame)
        self._has_begun = True
        if self._is_numbered and not _TRC_NUMBER.fullmatch(cells[0]):
            return False
        if len(cells) < _TRC_LEAST or any(cell.endswith(")") for cell in cells[1:]):
            return False
        if self._types and self._types.isdisjoint(cells[1:5]):
            return False
        is_event = not _TRC_EVENTS.isdisjoint(cells[1:5])
        rest = line.partition(" ")[2].strip() if self._is_numbered else line
        return is_event or _TRC_FRAME.fullmatch(rest) is not None
