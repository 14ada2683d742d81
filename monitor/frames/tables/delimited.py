"""Text tables (.csv, .msl, .txt): rows to blocks of numbers, read by their dialect."""

import csv
import re
from collections.abc import Container, Iterable, Iterator, Sequence
from functools import partial
from itertools import islice
from math import isnan, nan
from pathlib import Path
from typing import Final

import numpy as np

from monitor.base.counts import counted
from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from monitor.frames.blocks import DAMAGED_SHARE
from monitor.frames.bounds import open_text
from monitor.frames.tables.cells import (
    ColumnClock,
    Parse,
    exact_number,
    is_no_value,
    is_plain,
    number,
    of_unit,
    of_words,
)
from monitor.frames.tables.dialect import (
    ANNOTATIONS,
    Dialect,
    bare,
    dialect_of,
    one_line,
    ungrouped,
)
from monitor.frames.tables.haltech import NO_VALUE, haltech_dialect
from monitor.frames.tables.raw_table import Notes, Pivot, RawColumn, RawTable, Wanted
from monitor.frames.units import unit_of

_ROWS: Final = 1 << 13  # of a block
MOST_NAMES: Final = 4096  # of a table with one value a row
# usual names of the columns of a table with one value a row: of the name, the value and the unit
_LONG: Final = (
    "pid name signal parameter channel variable sensor field item metric topic messwert",
    "value wert reading valor valeur payload messwert",
    "units unit einheit uom unidad unité",
)
_STATES: Final = ("entity_id", "state", "unit_of_measurement")  # the same, of Home Assistant
# of a column that tells whose a row's values are
_SOURCES: Final = re.compile(
    r"(?:vehicle|car|vin|device|host|source|ecu|module|imei|fahrzeug|steuergerät|gerät)"
    r"(?:[ _]?(?P<numbered>id|name|no|nr|number))?\.?",
    re.I,
)
# of a last column, which rows may lack
_REMARKS: Final = re.compile("comment|remark|note|bemerkung", re.I)
_MARKS: Final = ("mark", '"mark', "#", "//")  # lines that a logger writes between the rows


def open_delimited(path: Path, pivot: Pivot | None = None) -> RawTable:
    """Return the logger's text table in ``path``.

    pivot : columns of a table with one value a row; such a table is known by usual names, too
    Raises RecordingError if it has no header with numbers below it, or not these columns.
    """
    dialect = haltech_dialect(path) or dialect_of(path)
    long = long_table(path, dialect, pivot)
    if pivot and not long:
        wanted = f"{pivot.name} with texts and {pivot.value} with numbers"
        raise RecordingError(f"{path}: the profile's pivot wants the columns {wanted}")
    read = partial(_read, path, dialect)
    return long or RawTable(path, dialect.kind, dialect.columns, read, dialect.preamble)


def long_table(path: Path, dialect: Dialect, pivot: Pivot | None = None) -> RawTable | None:
    """Return a table whose rows hold a time, a name and one value, with a column for each name.

    None if the columns are others, or the names more than ``MOST_NAMES``.
    """
    names = (each.name.casefold().strip("_") for each in dialect.columns)
    places = {each: i for i, each in enumerate(names) if each}
    usual = _STATES if _STATES[0] in places else _LONG
    wanted = [(n.casefold().strip("_"),) for n in pivot] if pivot else map(str.split, usual)
    name, value, unit = (next((places[w] for w in words if w in places), None) for words in wanted)
    if name is None or value in (None, name) or dialect.columns[name].kind != "text":
        return None
    units, said = dict[str, str](), [""]  # names, repeats left out
    sources, source = dict[str, str](), _source_of(dialect)
    begin, row = list[str](), list[str]()
    for line, row in _rows(path, dialect, 0, Notes()):
        begin = begin or row
        for place, of, told in (unit, "in", units), (source, "of", sources):
            own = row[place].strip() if place is not None else ""
            if (before := told.setdefault(row[name].strip(), own)) != own:
                was = f"before {of} {before!r}"
                raise RecordingError(f"{path}: line {line}: {row[name]} {of} {own!r}, {was}")
        if len(units) > MOST_NAMES:
            return None
        if len(said) <= len(units) and said[-1] != row[name]:
            said.append(row[name])
    first = [i for i in places.values() if i not in (name, value, unit)]
    columns = (*(dialect.columns[i] for i in first), *(RawColumn(*each) for each in units.items()))
    clocks = [i for i in first if dialect.columns[i].kind == "clock" and row[i] != begin[i]]
    is_apart = len(said) == len(units) + 1 > 2
    order = next(iter(clocks or first), None) if is_apart else None
    read = partial(_read_long, path, dialect, (*first, *units), name, value, order)
    return RawTable(path, f"{dialect.kind}, one value a row", columns, read, dialect.preamble)


def _source_of(dialect: Dialect) -> int | None:
    """Return the column that tells of which vehicle or device a row's values are."""
    for i, each in enumerate(dialect.columns):
        named = _SOURCES.fullmatch(each.name)
        if named and (each.kind == "text" or named["numbered"]):  # other numbers are a signal's
            return i
    return None


def _one_source(
    path: Path, dialect: Dialect, rows: Iterator[tuple[int, list[str]]], source: int
) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows; raise RecordingError if two sources change a column of numbers.

    source : the column that tells it; one column that both change may be the time
    """
    numbers = [i for i, each in enumerate(dialect.columns) if each.kind in ("number", "measure")]
    filled, last = dict[int, str](), list[str]()
    for line, row in rows:
        own, last, before = row[source], row, last or row
        changed = [i for i in numbers if own and row[i] and row[i] != before[i]]
        both = [i for i in changed if filled.setdefault(i, own) != own]
        if len(both) > 1 + (source in numbers):
            told = f"{dialect.columns[both[-1]].name} of {own!r}, before of {filled[both[-1]]!r}"
            raise RecordingError(f"{path}: line {line}: {told}: the rows of one are wanted")
        yield line, row


def _read_long(
    path: Path,
    dialect: Dialect,
    columns: Sequence[int | str],
    name: int,
    value: int,
    order: int | None,
    wanted: Sequence[Wanted],
    notes: Notes,
) -> Iterator[FloatArray]:
    """Yield blocks of a long table, with one row for the values of one time.

    columns : of the raw table: a column's number, or one of the names
    order : the column that orders the rows of a file which holds one signal after the other
    """
    rows = _rows(path, dialect, value + 1, notes)
    if order is not None:
        at = _parser(dialect, Wanted(order))
        rows = iter(sorted(rows, key=lambda numbered: at(numbered[1][order])))
    parse = _number(dialect)
    chosen = [columns[each.column] for each in wanted]
    plain = [
        (k, i, _parser(dialect, Wanted(i))) for k, i in enumerate(chosen) if isinstance(i, int)
    ]
    named = {each: [k for k, same in enumerate(chosen) if same == each] for each in chosen}
    while block := list(islice(rows, _ROWS)):
        cells, n, before, here = np.full((len(block), len(wanted)), np.nan), -1, [""], set[str]()
        for _, row in block:
            said, times = row[name].strip(), [row[i] for _, i, _ in plain]
            if n < 0 or said in here or times != before:
                n, before, here = n + 1, times, set()
                for k, i, each in plain:
                    cells[n, k] = each(row[i])
            here.add(said)
            if places := named.get(said):
                cells[n, places] = parse(row[value])
        yield cells[: n + 1]


def _read(
    path: Path, dialect: Dialect, wanted: Sequence[Wanted], notes: Notes
) -> Iterator[FloatArray]:
    parsers = [_parser(dialect, each) for each in wanted]
    places = [each.column for each in wanted]
    is_whole = dialect.is_exact and places == list(range(len(dialect.columns)))
    rows = _rows(path, dialect, max(places, default=0) + 1, notes)
    if (source := _source_of(dialect)) is not None:
        rows = _one_source(path, dialect, rows, source)
    plain = all(parse in (number, exact_number) for parse in parsers)
    steps = np.array([dialect.steps[i] for i in places]) if dialect.steps else 1.0
    odd: list[str] = []  # cells that are no number in the unit of their column
    loose: list[str] = []  # other texts
    while True:
        block: list[list[float]] = []
        for line, row in islice(rows, _ROWS):
            cells = row if is_whole else [row[i] for i in places]
            try:
                if not plain or not is_plain("".join(cells)):
                    raise ValueError
                block.append(list(map(float, cells)))
            except ValueError:
                names = (dialect.columns[i].name for i in places)
                told = zip(names, parsers, cells, strict=True)
                block.append([_value(path, line, odd, loose, *each) for each in told])
            if len(odd) > 1 + DAMAGED_SHARE * line:
                raise RecordingError(f"{path}: {odd[0]}, a number in its unit is wanted")
        if not block:
            break
        found = np.array(block, dtype=np.float64).reshape(len(block), len(places))
        if not dialect.is_exact:
            found[np.abs(found) >= (NO_VALUE if dialect.steps else np.inf)] = np.nan
        yield found * steps
    for each in filter(None, (odd, loose)):
        left_out = f"{counted(len(each), 'unreadable cell')} left out"
        notes.sentences.append(f"{left_out}, the first: {each[0]}")


def _value(
    path: Path, line: int, odd: list[str], loose: list[str], name: str, parse: Parse, cell: str
) -> float:
    """Return a cell's value; NaN for one that cannot be read, which is told.

    odd : takes those of other units, loose : other texts
    """
    try:
        if not isnan(value := parse(cell)) or isinstance(parse, ColumnClock) or is_no_value(cell):
            return value
        to = loose
    except ValueError:
        to = odd
    to.append(to[0] if to else f"line {line}: column {name} is {cell.strip()[:40]!r}")
    if parse is exact_number:
        raise RecordingError(f"{path}: {to[-1]}, a number is wanted")
    return nan


def _parser(dialect: Dialect, wanted: Wanted) -> Parse:
    if dialect.is_exact:
        return exact_number
    if wanted.words:
        return of_words(wanted.words)
    column = dialect.columns[wanted.column]
    if column.kind == "clock":
        return ColumnClock()
    parse = _number(dialect)
    return of_unit(column.unit, parse) if column.kind == "measure" else parse


def _number(dialect: Dialect) -> Parse:
    parse = partial(number, comma=True) if dialect.decimal_comma else number
    return (lambda text: parse(ungrouped(text, dialect.grouping))) if dialect.grouping else parse


def _rows(
    path: Path, dialect: Dialect, least: int, notes: Notes
) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of the rows of data.

    least : cells that a row must have
    A row of another length is left out and told; more than ``DAMAGED_SHARE`` of them, or one of the
    project's own tables, raise RecordingError with line, what came and what was wanted.
    """
    width = len(dialect.columns)
    named = max((i for i, each in enumerate(dialect.columns, 1) if each.name), default=0)
    may_lack = bool(_REMARKS.match(dialect.columns[-1].name))
    least = width if dialect.is_exact else max(least, named)
    with open_text(path, dialect.encoding, errors=dialect.errors) as text:
        reader = csv.reader(
            _ended_quotes(text, dialect.skip) if dialect.has_quotes else text,
            delimiter=dialect.separator,
            skipinitialspace=True,
            quoting=csv.QUOTE_MINIMAL if dialect.has_quotes else csv.QUOTE_NONE,
        )
        odd: list[str] = []  # rows of another length
        last_odd = 0
        try:
            for cells in _data(reader, dialect, notes):
                row = [*cells, ""] if may_lack and len(cells) == width - 1 else cells
                if least <= len(row) and (len(row) == width or not dialect.is_exact):
                    yield reader.line_num, row
                else:
                    found, columns = counted(len(row), "cell"), counted(width, "column")
                    last_odd = reader.line_num
                    odd.append(f"line {last_odd}: {found}, the header has {columns}")
                if odd and (dialect.is_exact or len(odd) > 1 + DAMAGED_SHARE * reader.line_num):
                    raise RecordingError(f"{path}: {odd[0]}")
        except csv.Error as error:
            raise RecordingError(f"{path}: line {reader.line_num}: {error}") from error
        except EOFError as error:
            if dialect.is_exact:
                raise
            notes.sentences.append(f"cut short after line {reader.line_num}: {error}")
    if odd and last_odd == reader.line_num:  # the logger was switched off while it wrote
        notes.sentences.append(f"cut short in {odd.pop()}")
    if odd:
        notes.sentences.append(f"{counted(len(odd), 'row')} left out, the first: {odd[0]}")


def _ended_quotes(text: Iterable[str], header: int) -> Iterator[str]:
    """Yield the lines; below the header, a quote that has no end would swallow all that follows.

    header : rows of it
    """
    is_open = False  # a cell of the header that goes on in the next line
    for line in text:
        is_odd = line.count('"') % 2 == 1
        yield line.replace('"', "") if is_odd and not header else line
        is_open ^= is_odd
        header -= bool(header and line.strip() and not is_open)


def _data(reader: Iterable[list[str]], dialect: Dialect, notes: Notes) -> Iterator[list[str]]:
    """Yield the rows of data; marks and repeated headers are counted and left out."""
    width, skip, begun = len(dialect.columns), dialect.skip, False
    names = [column.name for column in dialect.columns]
    known = {name.partition("#")[0] for name in names}
    for row in reader:
        is_blank = not dialect.separator.join(row).strip()
        if is_blank or (dialect.row and not dialect.row.match(row[0])):
            continue
        if skip:
            skip -= 1
            cells = zip(map(one_line, row), dialect.columns, strict=False)
            new = [each.name for cell, each in cells if begun and _is_other_unit(cell, each.unit)]
            if new:
                notes.sentences.append(f"read up to a header with another unit of {new[0]}")
                return
        elif dialect.is_exact:
            yield row
        elif row[0] in ANNOTATIONS:
            continue
        elif len(row) < width and row[0].strip().casefold().startswith(_MARKS):
            notes.count("markers")
        elif not any(each[:1].isdigit() for each in row) and _is_header(row, known):
            pairs = zip(map(one_line, row), names, strict=False)
            new = [cell for cell, name in pairs if cell and not f"{name}#".startswith(f"{cell}#")]
            if new:
                notes.sentences.append(f"read up to a header with other columns: {new[0]}, …")
                return
            skip, begun = dialect.below_names, True
            notes.count("repeated_headers")
        else:
            yield row


def _is_header(row: Sequence[str], known: Container[str]) -> bool:
    """Return whether half of a row's cells are names of columns, or all of them differing words."""
    cells = [cell for cell in map(one_line, row) if not is_no_value(cell)]
    is_words = len({*cells}) == len(row) and all(cell[0].isalpha() for cell in cells)
    return len(cells) > 1 and (is_words or 2 * sum(cell in known for cell in cells) >= len(cells))


def _is_other_unit(cell: str, unit: str) -> bool:
    before, now = unit_of(unit, 1.0), unit_of(bare(cell), 1.0)
    return bool(before and now and before != now)
