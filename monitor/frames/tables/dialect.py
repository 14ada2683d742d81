"""The dialect of a text table, from its first lines: encoding, separator, header, units, cells."""

import codecs
import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from monitor.base.errors import RecordingError
from monitor.frames.logs import open_binary
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


@dataclass(frozen=True, slots=True)
class Dialect:
    """How a text table is written."""

    encoding: str
    separator: str
    decimal_comma: bool
    header: int  # rows before the header, blank lines not counted
    has_units: bool  # a row of units follows the header
    columns: tuple[RawColumn, ...]
    preamble: str

    @property
    def in_words(self) -> str:
        """Return the dialect in words."""
        between = {"\t": "tabs", ";": "semicolons", ",": "commas"}[self.separator]
        comma = ", decimal commas" if self.decimal_comma else ""
        return f"text table, {between}{comma}, {self.encoding}"


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
    text = head.decode(encoding, errors="ignore")
    lines = [line for line in text.splitlines()[:-1] or text.splitlines() if line.strip()][:_LINES]
    best = max((_rows(lines, sep) for sep in _SEPARATORS), key=_width)
    separator, rows = best
    comma = separator != "," or '"' in text
    comma = comma and any(_COMMA.fullmatch(cell.strip()) for row in rows[-5:] for cell in row)
    data = _first_data_row(rows, comma=comma)
    if data is None or data == 0:
        raise RecordingError(f"{path}: no row of column names with rows of numbers below it")
    width = len(rows[data])
    header = data - 1
    has_units = header > 0 and _is_wide(rows[header - 1], width) and _is_wide(rows[header], width)
    header -= has_units
    columns = _columns(rows[header], rows[header + 1] if has_units else (), rows[data:], comma=comma)
    return Dialect(
        encoding, separator, comma, header, has_units, columns, "\n".join(lines[:header])
    )


def _rows(lines: Sequence[str], separator: str) -> tuple[str, list[list[str]]]:
    try:
        return separator, list(csv.reader(io.StringIO("\n".join(lines)), delimiter=separator))
    except csv.Error:
        return separator, [[]]


def _width(rows: tuple[str, list[list[str]]]) -> int:
    """Return the middle number of cells of the last rows, where the data are."""
    widths = sorted(len(row) for row in rows[1][-_SAMPLE:])
    return widths[len(widths) // 2]


def _is_wide(row: Sequence[str], width: int) -> bool:
    return len(row) >= 0.8 * width and (width > 1 or bool(row))


def _first_data_row(rows: Sequence[Sequence[str]], *, comma: bool) -> int | None:
    """Return the number of the first row that holds numbers for the most part."""
    for i, row in enumerate(rows):
        filled = [cell for cell in row if not is_no_value(cell)]
        numbers = sum(is_number(cell, comma=comma) or clock(cell) == clock(cell) for cell in filled)  # noqa: PLR0124
        following = rows[i + 1] if i + 1 < len(rows) else row
        if filled and 2 * numbers >= len(filled) and len(following) == len(row) and (
            i == 0 or _is_wide(rows[i - 1], len(row))
        ):
            return i
    return None


def _columns(
    names: Sequence[str], units: Sequence[str], sample: Sequence[Sequence[str]], *, comma: bool
) -> tuple[RawColumn, ...]:
    columns = []
    for i, cell in enumerate(names):
        name, unit = cell.strip(), units[i].strip() if i < len(units) else ""
        found = [row[i] for row in sample[:_SAMPLE] if i < len(row) and not is_no_value(row[i])]
        kind, wraps_s = "number", 0.0
        if found and not any(is_number(text, comma=comma) for text in found):
            times = [text for text in found if clock(text) == clock(text)]  # noqa: PLR0124
            kind = "clock" if 2 * len(times) > len(found) else "text"
            wraps_s = wrap_s(times[0]) if kind == "clock" else 0.0
        columns.append(RawColumn(name, unit, kind, wraps_s))  # type: ignore[arg-type]
    return tuple(columns)


def name_and_unit(text: str) -> tuple[str, str]:
    """Return a column's name without what stands in brackets at its end, and that.

    >>> name_and_unit("Barometric pressure (from vehicle)(psi)")
    ('Barometric pressure (from vehicle)', 'psi')
    """
    match = _IN_BRACKETS.fullmatch(text.strip())
    return (match[1], match[2].strip()) if match else (text.strip(), "")
