"""The dialect of a text table, from its first lines: encoding, separator, header, units, cells.

The project's own dialect is CSV with commas and points, every cell a number or blank.
"""

import codecs
import csv
import io
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan
from pathlib import Path
from typing import Final, NamedTuple

from monitor.base.errors import RecordingError
from monitor.frames.bounds import LINE_BYTES, open_binary
from monitor.frames.tables.cells import clock, is_no_value, is_number, wrap_s
from monitor.frames.tables.raw_table import RawColumn

HEAD_BYTES: Final = 1 << 18
_LINES: Final = 60  # of the head that are looked at
_SEPARATORS: Final = ("\t", ";", ",")
_BOMS: Final = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_SAMPLE: Final = 20  # rows that tell what a column holds
_COMMA: Final = re.compile(r"-?\d+,\d+")
_IN_BRACKETS: Final = re.compile(r"(.+?)\s*[(\[]([^()\[\]]*)[)\]]\s*")


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialect:
    """How a text table is written."""

    kind: str  # format in words
    columns: tuple[RawColumn, ...]
    encoding: str
    errors: str = "replace"  # of the encoding, as for ``open``
    separator: str = ","
    decimal_comma: bool = False
    has_quotes: bool = True  # cells may stand in quotes
    skip: int = 0  # rows before the first row of data, blank lines not counted
    has_units: bool = False  # a row of units follows each header
    row: re.Pattern[str] | None = None  # how rows of data begin; None: all behind the header are
    steps: tuple[float, ...] = ()  # value of 1 in each column; () 1
    is_exact: bool = False  # every cell is a number or blank, every row has all cells
    preamble: str = ""


def own_dialect(path: Path) -> Dialect | None:
    """Return the project's own dialect if the first two lines of ``path`` have it, else None.

    Raises OSError as ``open``.
    """
    with open_binary(path) as file:
        head = file.read(LINE_BYTES).replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    lines = head.split(b"\n", 2)[:2]
    if any(mark in line for line in lines for mark in (b'"', b";", b"\t", b"\0")):
        return None
    try:
        header, encoding, errors = lines[0].decode("utf-8"), "utf-8", "strict"
    except UnicodeDecodeError:  # Windows' own Western encoding
        header, encoding, errors = lines[0].decode("cp1252", errors="replace"), "cp1252", "replace"
    names = header.lstrip("\ufeff").split(",")
    return Dialect(
        kind="table",
        columns=tuple(RawColumn(name.strip()) for name in names),
        encoding=encoding,
        errors=errors,
        has_quotes=False,
        skip=1,
        is_exact=True,
    )


def encoding_of(head: bytes) -> str:
    """Return the encoding of a text that begins with ``head``."""
    for bom, name in _BOMS:
        if head.startswith(bom):
            return name
    if head[:2000].count(0) > len(head[:2000]) // 4:  # UTF-16 without a mark of its byte order
        return "utf-16-be" if head[:1] == b"\0" else "utf-16-le"
    decoder = codecs.getincrementaldecoder("utf-8")()
    try:
        decoder.decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


def dialect_of(path: Path) -> Dialect:
    """Return the dialect of the text table in ``path``.

    Raises RecordingError if no header with data below it is found, OSError as ``open``.
    """
    with open_binary(path) as file:
        head = file.read(HEAD_BYTES)
    if not head.strip():
        raise RecordingError(f"{path}: the table is empty")
    encoding = encoding_of(head)
    if encoding in ("utf-8", "cp1252") and b"\0" in head[:2000]:
        raise RecordingError(f"{path}: holds binary data, a log or table is wanted")
    lines = head.decode(encoding, errors="ignore").splitlines()
    if len(head) == HEAD_BYTES:
        lines = lines[:-1]
    lines = [line for line in lines if line.strip()][:_LINES]
    found = [each for each in (_layout(lines, separator) for separator in _SEPARATORS) if each]
    if not found:
        raise RecordingError(f"{path}: no row of column names with rows of numbers below it")
    best = max(found, key=lambda each: each.width)
    header, width = best.data - 1, best.width
    has_units = header > 0 and all(_is_wide(best.rows[i], width) for i in (header - 1, header))
    header -= has_units
    columns = _columns(
        best.rows[header],
        best.rows[header + 1] if has_units else (),
        best.rows[best.data :],
        comma=best.comma,
    )
    between = {"\t": "tabs", ";": "semicolons", ",": "commas"}[best.separator]
    comma = ", decimal commas" if best.comma else ""
    return Dialect(
        kind=f"text table, {between}{comma}, {encoding}",
        columns=columns,
        encoding=encoding,
        separator=best.separator,
        decimal_comma=best.comma,
        skip=header + 1 + has_units,
        has_units=has_units,
        preamble="\n".join(lines[:header]),
    )


class _TextLayout(NamedTuple):
    separator: str
    comma: bool  # of decimals
    rows: list[list[str]]
    data: int  # the first row of data
    width: int  # cells of a row of data


def _layout(lines: Sequence[str], separator: str) -> _TextLayout | None:
    """Return how the lines read with a separator, None if there is no header with data below."""
    try:
        rows = list(csv.reader(io.StringIO("\n".join(lines)), delimiter=separator))
    except csv.Error:
        return None
    comma = separator != "," or any('"' in line for line in lines)
    comma = comma and any(_COMMA.fullmatch(cell.strip()) for row in rows for cell in row)
    data = _first_data_row(rows, comma=comma)
    return _TextLayout(separator, comma, rows, data, _width(rows[data:])) if data else None


def _width(rows: Sequence[Sequence[str]]) -> int:
    """Return how many cells most of the rows have; of equally many lengths, the first."""
    return Counter(map(len, rows)).most_common(1)[0][0]


def _is_wide(row: Sequence[str], width: int) -> bool:
    """Return whether a row above the data may be names or units; blanks at its end may lack."""
    return 0.8 * width <= len(row) <= width + 1


def _first_data_row(rows: Sequence[Sequence[str]], *, comma: bool) -> int | None:
    """Return the number of the first row of numbers below names; None if there is none."""
    for i in range(1, len(rows)):
        above = rows[i - 1]
        if (
            _is_data(rows[i], comma=comma)
            and _is_wide(above, _width(rows[i:]))
            and not _is_data(above, comma=comma)
        ):
            return i
    return None


def _is_data(row: Sequence[str], *, comma: bool) -> bool:
    """Return whether at least half of a row's cells are numbers or times; blanks do not count."""
    filled = [cell for cell in row if not is_no_value(cell)]
    numbers = sum(is_number(cell, comma=comma) or not isnan(clock(cell)) for cell in filled)
    return bool(filled) and 2 * numbers >= len(filled)


def _columns(
    names: Sequence[str], units: Sequence[str], sample: Sequence[Sequence[str]], *, comma: bool
) -> tuple[RawColumn, ...]:
    columns = []
    for i, cell in enumerate(names):
        name, unit = _one_line(cell), _one_line(units[i]) if i < len(units) else ""
        found = [row[i] for row in sample[:_SAMPLE] if i < len(row) and not is_no_value(row[i])]
        kind, wraps_s = "number", 0.0
        if found and not any(is_number(text, comma=comma) for text in found):
            times = [text for text in found if not isnan(clock(text))]
            kind = "clock" if 2 * len(times) > len(found) else "text"
            wraps_s = wrap_s(times[0]) if kind == "clock" else 0.0
        columns.append(RawColumn(name, unit, kind, wraps_s))  # type: ignore[arg-type]
    return tuple(columns)


def _one_line(text: str) -> str:
    """Return a name without line ends and other characters that cannot be printed."""
    return "".join(letter for letter in " ".join(text.split()) if letter.isprintable())


def name_and_unit(text: str) -> tuple[str, str]:
    """Return a column's name without the brackets at its end, and their text.

    >>> name_and_unit("Barometric pressure (from vehicle)(psi)")
    ('Barometric pressure (from vehicle)', 'psi')
    """
    match = _IN_BRACKETS.fullmatch(text.strip())
    return (match[1], match[2].strip()) if match else (text.strip(), "")
