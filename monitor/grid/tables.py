"""Recordings as tables: CSV, plain or gzipped, first column ``time_s``, one column per signal.

A columns map is a TOML file that says which column carries which canonical signal; columns it
does not name keep their own::

    lambda_measured = "AFR"                                          # as it is
    rail_pressure_mpa = { column = "FuelP", factor = 0.1, offset = 0.0 }
    time_s = { column = "t_ms", factor = 0.001 }                     # default: column time_s
"""

import gzip
import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final, cast

import numpy as np

from monitor.base.errors import ConfigError, RecordingError
from monitor.base.signals import plausible_range
from monitor.base.types import FloatArray, IntArray, Quality, QualityArray, Sample, SampleBlock
from monitor.grid.assembler import check_grid
from monitor.grid.block_assembler import assemble_arrays

TIME: Final = "time_s"
DEFAULT_PERIOD_NS: Final = 100_000_000
LONGEST_IN_NS_S: Final = 1e6
UNIFORM: Final = 0.01  # a table whose steps differ by less is used sample for sample
_ROWS: Final = 1 << 14  # read before they become an array, which takes less memory
_LOG_HEADER: Final = "timestamp,arbitration_id,"


@dataclass(frozen=True, slots=True)
class Column:
    """Where one signal of a table comes from: value = factor * cell + offset."""

    column: str
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class Table:
    """One recording as a table."""

    path: Path
    names: tuple[str, ...]  # without time_s
    t_ns: IntArray  # (n,) strictly rising
    values: FloatArray  # (n, n_names), NaN where the cell is blank


def is_table(path: str | Path) -> bool:
    """Return whether ``path`` is a table and not a CAN log, by its name and first line."""
    path = Path(path)
    name = path.name.lower()
    if name.endswith((".parquet", ".mdf", ".dat")):
        return True
    if not name.endswith((".csv", ".csv.gz")):
        return False
    try:
        with _open(path) as file:
            return not file.readline(200).startswith(_LOG_HEADER)
    except (OSError, EOFError, UnicodeDecodeError):
        return False


def load_columns(path: Path) -> dict[str, Column]:
    """Return the columns map in the TOML file ``path``.

    Raises ConfigError naming file and key if it cannot be used.
    """
    try:
        with path.open("rb") as file:
            raw = tomllib.load(file)
    except OSError as error:
        raise ConfigError(f"{path}: cannot read the columns map: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not a TOML file: {error}") from error
    return {name: _column(path, name, entry) for name, entry in raw.items()}


def _column(path: Path, name: str, entry: Any) -> Column:
    if isinstance(entry, str):
        return Column(entry)
    if not isinstance(entry, dict) or not isinstance(entry.get("column"), str):
        raise ConfigError(f"{path}: {name} is {entry!r}, a column's name is wanted")
    unknown = sorted(entry.keys() - {"column", "factor", "offset"})
    if unknown:
        raise ConfigError(f"{path}: [{name}] has the unknown key {unknown[0]!r}")
    for key in ("factor", "offset"):
        value = entry.get(key, 0.0)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ConfigError(f"{path}: [{name}] {key} is {value!r}, a number is wanted")
    return Column(entry["column"], float(entry.get("factor", 1.0)), float(entry.get("offset", 0.0)))


def read_table(path: str | Path, columns: str | Path | None = None) -> Table:
    """Return the table in the CSV file ``path``.

    columns : a columns map; without it every column keeps its name
    Raises RecordingError naming file, line and column if the table is missing, empty, has cells
    that are no numbers, rows of another length or times that do not rise.
    """
    path = Path(path)
    if not path.name.lower().endswith((".csv", ".csv.gz")):
        raise RecordingError(
            f"{path}: not a CSV table; 'o2train table' reads .parquet and .mf4 and writes .csv"
        )
    try:
        with _open(path) as file:
            first = file.readline().lstrip("\ufeff")
            header = [name.strip() for name in first.split(",")]
            if len(header) == 1 and ";" in first:
                raise RecordingError(
                    f"{path}: columns are parted by semicolons, commas are wanted, and points in "
                    "numbers"
                )
            cells = _cells(path, header, file)
    except (OSError, EOFError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise RecordingError(f"{path}: cannot read the table: {reason}") from error
    mapping = load_columns(Path(columns)) if columns is not None else None
    return make_table(path, header, cells, mapping)


def make_table(
    path: Path, header: Sequence[str], cells: FloatArray, columns: Mapping[str, Column] | None
) -> Table:
    """Return a table from its columns, (n, n_columns), under their canonical names.

    Raises RecordingError if a column is missing or twice there, or time does not rise.
    """
    if columns is None:
        columns = {name: Column(name) for name in header}
        if header and header[0] != TIME:
            raise RecordingError(f"{path}: the first column is {header[0]!r}, {TIME} is wanted")
    named = {name: Column(name) for name in header}
    columns = {TIME: Column(TIME), **named, **columns}
    places = {name: place for place, name in enumerate(header)}
    if len(places) < len(header):
        twice = next(name for name in header if list(header).count(name) > 1)
        raise RecordingError(f"{path}: line 1: the column {twice!r} is there twice")
    for name, each in columns.items():
        if each.column not in places:
            raise RecordingError(
                f"{path}: no column {each.column!r} for {name}, there are {', '.join(header)}"
            )
    if len(cells) == 0:
        raise RecordingError(f"{path}: the table has no rows")
    scaled = {}
    for name, each in columns.items():
        cell = cells[:, places[each.column]]
        neutral = each.factor == 1.0 and each.offset == 0.0
        scaled[name] = cell if neutral else cell * each.factor + each.offset
    time_s = scaled.pop(TIME)
    t_ns = _times(path, time_s)
    names = tuple(scaled)
    values = np.column_stack([scaled[name] for name in names]) if names else cells[:, :0]
    return Table(path, names, t_ns, values)


def _times(path: Path, time_s: FloatArray) -> IntArray:
    """Return times in nanoseconds; times since 1970 to microseconds, as those of frames are."""
    bad = np.flatnonzero(~np.isfinite(time_s))
    if bad.size:
        raise RecordingError(f"{path}: line {bad[0] + 2}: {TIME} is not a number")
    # a float holds nanoseconds of a drive, but only microseconds of the time since 1970
    step_ns = 1 if np.abs(time_s).max(initial=0.0) < LONGEST_IN_NS_S else 1000
    t_ns: IntArray = np.rint(time_s * (1e9 / step_ns)).astype(np.int64) * step_ns
    falling = np.flatnonzero(np.diff(t_ns) <= 0)
    if falling.size:
        row = int(falling[0]) + 1
        raise RecordingError(
            f"{path}: line {row + 2}: {TIME} is {time_s[row]:g} after {time_s[row - 1]:g}, "
            "rising times are wanted"
        )
    return t_ns


def _open(path: Path) -> IO[str]:
    """Open a table; one that is not UTF-8 is Windows' own Western encoding."""
    opened = gzip.open if path.name.lower().endswith(".gz") else open
    with opened(path, "rb") as file:
        header = file.readline()
    try:
        header.decode("utf-8")
    except UnicodeDecodeError:
        return cast("IO[str]", opened(path, "rt", encoding="cp1252", errors="replace", newline=""))
    return cast("IO[str]", opened(path, "rt", encoding="utf-8", newline=""))


def _cells(path: Path, header: Sequence[str], lines: IO[str]) -> FloatArray:
    """Return all cells, (n, n_columns); blank cells are NaN."""
    width = len(header)
    rows: list[list[float]] = []
    blocks = [np.empty((0, width))]
    for number, line in enumerate(lines, 2):
        text = line.strip()
        if not text:
            continue
        parts = text.split(",")
        if len(parts) != width:
            raise RecordingError(
                f"{path}: line {number}: {len(parts)} cells, the header has {width} columns"
            )
        try:
            rows.append([float(part) for part in parts])
        except ValueError:
            rows.append([_cell(path, number, *each) for each in zip(header, parts, strict=True)])
        if len(rows) == _ROWS:
            blocks.append(np.array(rows))
            rows = []
    blocks.append(np.array(rows, dtype=np.float64).reshape(len(rows), width))
    return np.concatenate(blocks)


def _cell(path: Path, number: int, name: str, text: str) -> float:
    try:
        return float(text) if text.strip() else math.nan
    except ValueError:
        raise RecordingError(
            f"{path}: line {number}: column {name} is {text.strip()[:40]!r}, a number is wanted"
        ) from None


def uniform_period_ns(t_ns: IntArray) -> int | None:
    """Return the period of times that are uniform within 1 %, None for others."""
    if len(t_ns) < 2:
        return None
    steps_ns = np.diff(t_ns)
    period_ns = round(int(t_ns[-1] - t_ns[0]) / len(steps_ns))
    if np.any(np.abs(steps_ns - period_ns) > UNIFORM * period_ns):
        return None
    return period_ns


def table_period_ns(table: Table, period_ns: int | None = None) -> int:
    """Return the sample period a table is used at: as asked, else its own, else 100 ms."""
    return period_ns or uniform_period_ns(table.t_ns) or DEFAULT_PERIOD_NS


def table_block(
    table: Table,
    names: Sequence[str],
    period_ns: int | None = None,
    timeouts_ns: Sequence[int] | None = None,
) -> SampleBlock:
    """Return a table's samples.

    names : columns wanted, in this order
    period_ns : grid period; None uses a table that is uniform within 1 % sample for sample
    timeouts_ns : how long each may be held on a grid; default 0.5 s or three rows' time
    Raises RecordingError if a column is missing or the period is impossible.
    """
    missing = [name for name in names if name not in table.names]
    if missing:
        raise RecordingError(f"{table.path}: has no column {', '.join(missing)}")
    values, quality = in_range(table.values[:, [table.names.index(name) for name in names]], names)
    own_ns = uniform_period_ns(table.t_ns)
    if own_ns is not None and (period_ns is None or abs(period_ns - own_ns) <= UNIFORM * own_ns):
        index = np.arange(len(values), dtype=np.int64)
        return SampleBlock(index, table.t_ns[0] + index * own_ns, values, quality)
    period_ns = period_ns or DEFAULT_PERIOD_NS
    check_grid(period_ns)
    if timeouts_ns is None:
        row_ns = int(np.median(np.diff(table.t_ns))) if len(table.t_ns) > 1 else 0
        timeouts_ns = [max(500_000_000, 3 * row_ns)] * len(names)
    marked = np.where(quality == Quality.OUT_OF_RANGE, np.inf, values)
    series = [(table.t_ns, marked[:, column]) for column in range(len(names))]
    return assemble_arrays(
        table.t_ns, series, names, names, period_ns=period_ns, timeouts_ns=timeouts_ns
    )


def table_samples(
    table: Table,
    names: Sequence[str],
    period_ns: int | None = None,
    timeouts_ns: Sequence[int] | None = None,
) -> Iterator[Sample]:
    """Yield a table's samples one by one; see ``table_block``."""
    block = table_block(table, names, period_ns, timeouts_ns)
    return map(Sample, block.index.tolist(), block.t_ns.tolist(), block.values, block.quality)


def in_range(values: FloatArray, names: Sequence[str]) -> tuple[FloatArray, QualityArray]:
    """Return values, NaN where not plausible, and their quality; both (n, n_names)."""
    values = values.copy()
    quality = np.zeros(values.shape, dtype=np.uint8)
    for column, name in enumerate(names):
        cell = values[:, column]
        low, high = plausible_range(name)
        outside = (cell < low) | (cell > high) | np.isinf(cell)
        quality[np.isnan(cell), column] = Quality.INVALID
        quality[outside, column] = Quality.OUT_OF_RANGE
        cell[outside] = np.nan
    return values, quality
