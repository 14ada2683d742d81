"""The dialect of a text table, from its first lines: encoding, separator, header, units, cells.

The project's own tables are CSV with commas and points, every cell a number or blank.
"""

import codecs
import csv
import io
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product, takewhile
from math import isnan
from pathlib import Path
from typing import Final, NamedTuple

from monitor.base.errors import RecordingError
from monitor.frames.bounds import head_of
from monitor.frames.tables.cells import THOUSANDS, clock, is_no_value, is_number, measure, wrap_s
from monitor.frames.tables.raw_table import RawColumn
from monitor.frames.units import restored, unit_of

OWN_TIME: Final = "time_s"  # first column of the project's own tables
HEAD_BYTES: Final = 1 << 18
LINES: Final = (60, 400)  # of the head that are looked at, the second if the first tell nothing
_SEPARATORS: Final = {"\t": "tabs", ";": "semicolons", ",": "commas", "|": "bars", " ": "blanks"}
_BOMS: Final = {codecs.BOM_UTF8: "utf-8-sig"} | dict.fromkeys(
    (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE), "utf-16"
)
_HEADER: Final = 4  # most rows of a header: a group, names, other names, units
_TITLES: Final = 2  # most rows with one cell between header and data
_SAMPLE: Final = 20  # rows that tell what a column holds
_COMMA: Final = re.compile(r"-?\d+,\d+(?:e[-+]?\d+)?", re.I)
_POINT: Final = re.compile(r"-?\d+\.\d+")
# the first that fits: Chinese pairs, syllables, words of what stands alone in the West, ø and è
_LETTERS: Final = {
    "gb18030": re.compile(rb"(?:[\0-\x7f]|[\xa1-\xf7][\xa1-\xfe])*[\xa1-\xf7]?\Z"),
    "shift_jis": re.compile(rb"(?s:.*)(?:[\x82\x83][\x40-\xf1]){2}"),
    "cp1251": re.compile(rb"(?s:.*)[\xc0-\xff]{4}"),
    "cp1250": re.compile(
        rb"(?s)(?=.*[\xe1\xfd])(?=.*[\xc8\xe8\xec\xf8\xf9])"
        rb"|.*[a-z](?:[\xb3\xb9\xbe\xbf][a-z]|[\x9a\x9c-\x9f])"
    ),
}
ANNOTATIONS: Final = ("#group", "#datatype", "#default")  # first cells of InfluxDB's, no names
_HEADER_ENDS: Final = re.compile(r"\W*end[ _]of[ _]header\W*", re.I)  # LabVIEW's
_GROUPS: Final = re.compile(r"-?[1-9]\d{0,2}(?:(['’.\xa0\u202f ])\d{3})+(?:[.,]\d+)?")  # 3.645
_IN_BRACKETS: Final = re.compile(r"(.*\S)\s*[(\[{]((?:[^()\[\]{}]|\(\w\))*)[)\]}]\s*")
_IN_BARS: Final = re.compile(r'([^|]+)\|"?([^|"]*)"?(?:\|[\d.]+)+')  # RaceCapture's
_BEHIND_COMMA: Final = re.compile(r"(.+?),\s*+([^,]+)")


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialect:
    """How a text table is written."""

    kind: str  # format in words
    columns: tuple[RawColumn, ...]
    encoding: str
    errors: str = "replace"  # of the encoding, as for ``open``
    separator: str = ","
    decimal_comma: bool = False
    grouping: str = ""  # characters that part the thousands of a number
    has_quotes: bool = True  # cells may stand in quotes
    skip: int = 0  # rows before the first row of data, blank lines not counted
    below_names: int = 0  # rows between the names and the data, of units as a rule
    row: re.Pattern[str] | None = None  # how rows of data begin; None: all behind the header are
    steps: tuple[float, ...] = ()  # value of 1 in each column; () 1
    is_exact: bool = False  # every cell is a number or blank, every row has all cells
    preamble: str = ""


def encoding_of(head: bytes) -> str:
    """Return the encoding of a text that begins with ``head``."""
    for bom, name in _BOMS.items():
        if head.startswith(bom):
            return name
    if head[:2000].count(0) > len(head[:2000]) // 4:  # UTF-16 without a mark of its byte order
        return "utf-16-be" if head[:1] == b"\0" else "utf-16-le"
    decoder = codecs.getincrementaldecoder("utf-8")()
    try:
        decoder.decode(head)
    except UnicodeDecodeError:
        fitting = (name for name, letters in _LETTERS.items() if letters.match(head))
        return next(fitting, "cp1252")
    return "utf-8"


def dialect_of(path: Path) -> Dialect:
    """Return the dialect of the text table in ``path``.

    Raises RecordingError if no header with data below it is found, OSError as ``open``.
    """
    head = head_of(path, HEAD_BYTES)
    if not head.strip():
        raise RecordingError(f"{path}: the table is empty")
    encoding = encoding_of(head)
    if not encoding.startswith("utf-16") and b"\0" in head[:2000]:
        raise RecordingError(f"{path}: holds binary data, a log or table is wanted")
    lines = head.decode(encoding, errors="ignore").splitlines()
    if len(head) == HEAD_BYTES:
        lines = lines[:-1]
    lines = [line for line in lines if line.strip()]
    first = max((i + 1 for i, line in enumerate(lines) if _HEADER_ENDS.fullmatch(line)), default=0)
    *marks, blank = _SEPARATORS
    found: list[_TextLayout] = []
    for separators, most in product((marks, [blank]), LINES):
        looked_at = lines[first : first + most]
        found = found or [each for s in separators if (each := _layout(looked_at, s))]
    if not found:
        raise RecordingError(f"{path}: no row of column names with rows of numbers below it")
    best = max(found, key=lambda each: (each.support * each.width, each.width))
    comma = ", decimal commas" if best.comma else ""
    columns = _columns(best)
    return Dialect(
        kind=f"text table, {_SEPARATORS[best.separator]}{comma}, {encoding}",
        columns=columns,
        encoding=encoding,
        separator=best.separator,
        decimal_comma=best.comma,
        grouping=best.grouping,
        skip=first + best.data,
        below_names=best.data - 1 - best.header[0],
        is_exact=columns[0].name == OWN_TIME and best.separator == "," and not best.comma,
        preamble="\n".join(lines[: first + best.header[0]]),
    )


class _TextLayout(NamedTuple):
    separator: str
    comma: bool  # of decimals
    grouping: str
    rows: list[list[str]]
    header: list[int]  # rows of names, units and other names
    data: int  # the first row of data
    width: int  # cells of a row of data
    support: int  # rows of data that the header can name


def _layout(lines: Sequence[str], separator: str) -> _TextLayout | None:
    """Return how the lines read with a separator, None if there is no header with data below.

    Of several headers the one counts that names most rows: settings may stand above a table.
    """
    if separator == " ":  # a mark before the names is no name
        lines = [line.rstrip().lstrip("#% ") for line in lines]
    try:
        text = io.StringIO("\n".join(lines))
        rows = list(csv.reader(text, delimiter=separator, skipinitialspace=True))
    except csv.Error:
        return None
    comma = separator != "," or any('"' in line for line in lines)
    table = [row for row in rows if comma and len(row) > 1]
    cells = [measure(cell)[0].strip() for row in table for cell in row]
    in_thousands = any(map(_POINT.fullmatch, cells)) and separator == ","
    comma = any(
        _COMMA.fullmatch(cell) and not (in_thousands and THOUSANDS.fullmatch(cell))
        for cell in cells
    )
    grouping = "".join({mark[1] for mark in map(_GROUPS.fullmatch, cells) if mark})
    if not comma or any("." in c and is_number(c) and not _GROUPS.fullmatch(c) for c in cells):
        grouping = grouping.replace(".", "")  # of decimals
    rows = [[ungrouped(cell, grouping) for cell in row] for row in rows] if grouping else rows
    is_data = [_is_data(row, comma=comma) for row in rows]
    for n, row in enumerate(rows[1:], 1):  # below names, 1, 2, 3, … are the numbers of the columns
        is_data[n] &= row != [str(i + 1) for i in range(len(row))]
    best: _TextLayout | None = None
    for data in range(1, len(rows)):
        if not is_data[data] or is_data[data - 1]:
            continue
        width = Counter(map(len, rows[data:])).most_common(1)[0][0]
        width -= not any(row[width - 1].strip() for row in rows[data:] if len(row) == width)
        header = _header(rows, is_data, data, width)
        named = len({i for row in header for i, cell in enumerate(rows[row]) if cell.strip()})
        filled = [sum(not is_no_value(c) for c in row) for row in rows[data:]]
        support = sum(
            d and n <= 1.25 * named + 1 for d, n in zip(is_data[data:], filled, strict=True)
        )
        if header and (best is None or support > best.support):
            best = _TextLayout(separator, comma, grouping, rows, header, data, width, support)
    return best


def ungrouped(text: str, grouping: str) -> str:
    """Return a number without the marks of its thousands; any other text as it is."""
    drop = dict.fromkeys(map(ord, grouping)) if _GROUPS.fullmatch(text.strip()) else {}
    return text.translate(drop)


def _header(
    rows: Sequence[Sequence[str]], is_data: Sequence[bool], data: int, width: int
) -> list[int]:
    """Return the rows of the header, up to four; titles of sections may part it from the data."""
    below, filled = data - 1, [sum(bool(cell.strip()) for cell in row) for row in rows[:data]]
    while below >= 0 and filled[below] <= int(below >= data - _TITLES) < width:  # blank, or a title
        below -= 1
    upwards = range(below, max(-1, below - _HEADER), -1)
    return sorted(takewhile(lambda i: _is_wide(rows[i], width) and not is_data[i], upwards))


def _is_wide(row: Sequence[str], width: int) -> bool:
    """Return whether a row above the data may be names or units; blanks at its end may lack.

    Text in its first cell alone is a comment.
    """
    is_comment = width > 2 and bool(row[0].strip()) and not any(map(str.strip, row[1:]))
    is_comment |= row[0] in ANNOTATIONS
    return 0.8 * width <= len(row) <= width + 1 and not is_comment


def _is_data(row: Sequence[str], *, comma: bool) -> bool:
    """Return whether at least half of a row's cells are numbers or times; blanks do not count."""
    filled = [cell for cell in row if not is_no_value(cell)]
    told = (is_number(c, comma=comma) or measure(c)[1] or not isnan(clock(c)) for c in filled)
    return bool(filled) and 2 * sum(map(bool, told)) >= len(filled)


def _columns(layout: _TextLayout) -> tuple[RawColumn, ...]:
    header = [[one_line(cell) for cell in layout.rows[row]] for row in layout.header]
    units = _units_row(header)
    others = [row for row in header if row is not units]
    has_unit = [unit_of(cell, 1.0) is not None for cell in units or []]
    names = max(
        others,
        key=lambda row: (
            sum(bool(c) and u for c, u in zip(row, has_unit, strict=False)),
            sum(map(bool, row)),
            others.index(row),
        ),
    )
    if len(others) > 1 and len(set(filter(None, others[0]))) >= 0.8 * len(others[0]):
        names = others[0]  # two rows of names: the first is the tool's own
    below = header[header.index(names) + 1 :]
    columns, seen = [], Counter[str]()
    for i in range(max(map(len, header))):
        name, unit = _cell(names, i), bare(_cell(units or [], i))
        more = tuple(cell for row in others if row is not names and (cell := _cell(row, i)))
        told = (name_and_unit(each)[1] for each in more)
        unit = (unit if any(has_unit) else "") or next((t for t in told if unit_of(t, 1.0)), "")
        if not name and len(header) > 1:  # of a clock beside others
            unit = unit if unit_of(unit, 1.0) and len(below) > 1 else ""
            told = (_cell(row, i) for row in below if not unit or row is not units)
            name, more = " ".join(filter(None, told)), ()
        seen[name] += bool(name)
        name = f"{name}#{seen[name]}" if seen[name] > 1 else name
        column = _column(layout, i, name, unit, more)
        if not i and not name and len(header) == 1 and column.kind != "text":  # pandas' index
            column = replace(column, name="index")
        columns.append(column)
    while len(columns) > layout.width and not columns[-1].name:
        columns.pop()
    return tuple(columns)


def _units_row(header: Sequence[list[str]]) -> list[str] | None:
    """Return the row of units: above the names, else with most of them, else the second."""
    if len(header) < 2:
        return None
    above, *known = [sum(unit_of(c, 1.0) is not None for c in row if c) for row in header]
    if above > max(known) and above > 0.8 * sum(map(bool, header[0])):
        return header[0]
    best = max(range(len(known)), key=lambda row: (known[row], row))  # names may be units, too
    are_names = any(unit_of(name_and_unit(cell)[1], 1.0) for cell in header[1] if cell)
    return header[1 + best] if any(known) or (len(header) == 2 and not are_names) else None


def _cell(row: Sequence[str], i: int) -> str:
    return row[i] if i < len(row) else ""


def bare(text: str) -> str:
    """Return a unit without the brackets around it."""
    return text[1:-1].strip() if text[:1] + text[-1:] in ("()", "[]") else text


def _column(
    layout: _TextLayout, i: int, name: str, unit: str, others: tuple[str, ...]
) -> RawColumn:
    sample = layout.rows[layout.data : layout.data + _SAMPLE]
    found = [row[i] for row in sample if i < len(row) and not is_no_value(row[i])]
    kind, wraps_s = "number", 0.0
    if found and not any(is_number(text, comma=layout.comma) for text in found):
        times = [text for text in found if not isnan(clock(text))]
        kind = "clock" if 2 * len(times) > len(found) else "text"
        wraps_s = wrap_s(times[0]) if kind == "clock" else 0.0
        units = Counter(filter(None, (measure(text)[1] for text in found))).most_common(1)
        if units and 2 * units[0][1] >= len(found):
            unit, kind = units[0][0], "measure"
    return RawColumn(name, unit, kind, wraps_s, others)  # type: ignore[arg-type]


def one_line(text: str) -> str:
    """Return a name without line ends and other characters that cannot be printed."""
    return "".join(letter for letter in " ".join(restored(text).split()) if letter.isprintable())


def name_and_unit(text: str) -> tuple[str, str]:
    """Return a column's name without the brackets or the unit at its end, and their text.

    >>> name_and_unit("Barometric pressure (from vehicle)(psi)")
    ('Barometric pressure (from vehicle)', 'psi')
    >>> name_and_unit("MAP [kPa(g)]"), name_and_unit("Drehzahl, 1/min")
    (('MAP', 'kPa(g)'), ('Drehzahl', '1/min'))
    """
    match = _IN_BRACKETS.fullmatch(text.strip()) or _IN_BARS.fullmatch(text.strip())
    if match is None and (match := _BEHIND_COMMA.fullmatch(text.strip())):
        match = match if unit_of(match[2], 1.0) else None
    is_unit = match and not match[2].isdigit()  # but a number: of a sensor
    return (match[1], match[2].strip()) if match and is_unit else (text.strip(), "")
