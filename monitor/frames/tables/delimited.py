"""Text tables of loggers (.msl, .csv, .txt): rows to blocks of numbers, only the wanted columns."""

import csv
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np

from monitor.base.counts import counted
from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from monitor.frames.bounds import open_text
from monitor.frames.tables.cells import (
    Parse,
    clock,
    is_plain,
    number,
    number_with_comma,
    of_words,
)
from monitor.frames.tables.dialect import Dialect, dialect_of
from monitor.frames.tables.raw_table import Notes, RawTable, Wanted

_ROWS: Final = 1 << 13  # of a block
_MARKS: Final = ("mark", '"mark', "#", "//")  # lines that a logger writes between the rows


def open_delimited(path: Path) -> RawTable:
    """Return the text table in ``path``.

    Raises RecordingError if it has no header with numbers below it.
    """
    dialect = dialect_of(path)
    return RawTable(
        path, dialect.in_words, dialect.columns, partial(_read, path, dialect), dialect.preamble
    )


def _read(
    path: Path, dialect: Dialect, wanted: Sequence[Wanted], notes: Notes
) -> Iterator[FloatArray]:
    parsers = [_parser(dialect, each) for each in wanted]
    places = [each.column for each in wanted]
    rows = _rows(path, dialect, max(places, default=0) + 1, notes)
    plain = not dialect.decimal_comma and all(parse is number for parse in parsers)
    while True:
        block: list[list[float]] = []
        for row in islice(rows, _ROWS):
            cells = [row[i] for i in places]
            try:
                if not plain or not is_plain("".join(cells)):
                    raise ValueError
                block.append([float(cell) for cell in cells])
            except ValueError:
                block.append([parse(cell) for parse, cell in zip(parsers, cells, strict=True)])
        if not block:
            return
        yield np.array(block, dtype=np.float64).reshape(len(block), len(places))


def _parser(dialect: Dialect, wanted: Wanted) -> Parse:
    if wanted.words:
        return of_words(wanted.words)
    if dialect.columns[wanted.column].kind == "clock":
        return clock
    return number_with_comma if dialect.decimal_comma else number


def _rows(path: Path, dialect: Dialect, least: int, notes: Notes) -> Iterator[list[str]]:
    """Yield the rows of data; marks and repeated headers are counted and left out.

    least : cells that a row must have
    Raises RecordingError with line, what came and what was wanted for a row of another length.
    """
    width = len(dialect.columns)
    names = [column.name for column in dialect.columns]
    skip = dialect.header + 1 + dialect.has_units
    with open_text(path, dialect.encoding, errors="replace") as text:
        reader = csv.reader(text, delimiter=dialect.separator)
        short: tuple[int, int] | None = None
        try:
            for row in reader:
                if not row or (len(row) == 1 and not row[0].strip()):
                    continue
                if skip:
                    skip -= 1
                    continue
                if short is not None:
                    raise _other_length(path, short, width)
                if row[0].strip().casefold().startswith(_MARKS) and len(row) < width:
                    notes.count("markers")
                    continue
                if [cell.strip() for cell in row[:2]] == names[:2] and len(row) >= width:
                    skip = int(dialect.has_units)
                    notes.count("repeated_headers")
                    continue
                if len(row) < width - _trailing_blank(dialect) or len(row) < least:
                    short = (reader.line_num, len(row))
                    continue
                yield row
        except csv.Error as error:
            raise RecordingError(f"{path}: line {reader.line_num}: {error}") from error
        except EOFError as error:
            notes.sentences.append(f"cut short after line {reader.line_num}: {error}")
        if short is not None:  # the last row: the logger was switched off while it wrote
            notes.sentences.append(f"cut short in line {short[0]}: {_of_width(short[1], width)}")


def _trailing_blank(dialect: Dialect) -> int:
    """Return how many columns at the end have no name: rows may leave them out."""
    count = 0
    for column in reversed(dialect.columns):
        if column.name:
            break
        count += 1
    return count


def _other_length(path: Path, short: tuple[int, int], width: int) -> RecordingError:
    line, n = short
    return RecordingError(f"{path}: line {line}: {_of_width(n, width)}")


def _of_width(n: int, width: int) -> str:
    return f"{counted(n, 'cell')}, the header has {counted(width, 'column')}"
