"""Recordings as tables: the project's own CSV and Parquet tables, and the logs of tuning tools.

An own table has the first column ``time_s`` and one column per signal. With a columns map its
columns have other names. A file with other columns is read under a profile: a given one, or the
shipped one that its columns fit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from monitor.base.command_line.option_kinds import LOG, TABLE
from monitor.base.errors import RecordingError
from monitor.base.files.manifest import NAME, entry_of
from monitor.base.signals import BY_NAME, OUTPUT
from monitor.base.types import BoolArray, FloatArray, IntArray
from monitor.frames.blocks import LATEST_S
from monitor.frames.logs import checked_kind
from monitor.frames.profiles.profile import Profile, is_profile, load_profile, path_of, profile_of
from monitor.frames.profiles.recognition import key, places, recognised, recognised_own
from monitor.frames.profiles.signals import all_cells, read_signals
from monitor.frames.profiles.times import in_ns
from monitor.frames.tables.dialect import OWN_TIME
from monitor.frames.tables.parquet import read_parquet
from monitor.frames.tables.raw_table import Notes, RawTable, Wanted
from monitor.frames.tables.raw_table import Table as Table  # noqa: PLC0414 - known from here above
from monitor.frames.tables.readers import SUFFIXES, TEXT, open_table, suffix_of
from monitor.frames.text.layouts import layout_of
from monitor.grid.columns import Column, load_columns

TIME: Final = OWN_TIME
DEFAULT_PERIOD_NS: Final = 100_000_000
UNIFORM: Final = 0.01  # a table whose steps differ by less is used sample for sample
# periods for tables with uneven steps: the least that is not below the middle step
STEP_ABOVE: Final = 0.1  # by which the middle step may be above the period
PERIODS_NS: Final = tuple(round(s * 1e9) for s in (0.1, 0.2, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0))
BLANK: Final = "is blank, or 0 throughout"  # of a column that says nothing
_SHOWN: Final = 8  # columns that a message names


def is_table(path: str | Path) -> bool:
    """Return whether ``path`` is a table and not a CAN log, by its name and first line."""
    path = Path(path)
    if path.name.lower().endswith((".parquet", ".mdf", ".dat")):
        return True
    if suffix_of(path) not in TEXT:
        return suffix_of(path) in SUFFIXES
    try:
        return layout_of(path).layout is None
    except RecordingError:  # a log of a tool that is not read
        return False
    except (OSError, EOFError, ValueError):
        return suffix_of(path) != ".csv"


def kinds_of(path: Path) -> set[str]:
    """Return what a recording is for the options: a log, a table, or either if nothing tells it."""
    if is_table(path):
        return {TABLE}
    try:
        return {LOG, TABLE} if checked_kind(path) == ".mf4" else {LOG}
    except RecordingError:
        return {LOG, TABLE}


def checked_columns(given: Path) -> Path:
    """Return the file of a columns map or profile, which may be a shipped one's name.

    Raises ConfigError if it is neither or cannot be used.
    """
    path = path_of(given)
    if is_profile(path):
        load_profile(path)
    else:
        load_columns(path)
    return path


def read_table(
    path: str | Path,
    columns: str | Path | None = None,
    further: Sequence[str] = (),
    of_model: Mapping[str, Any] | None = None,
) -> Table:
    """Return the table in the file ``path``.

    columns : a columns map, or a profile; without it a profile of the user's is recognised, an own
        table's columns keep their names, and the shipped profile of other files is recognised
    further : columns of a logger's file to read under their own names
    of_model : tree of the profile in a model's card, for a logger's file that it fits
    Raises RecordingError naming file, line and column if the table is missing, empty, has cells
    that are no numbers, rows of another length or times that fall, or if no profile fits it.
    """
    path = Path(path)
    given = None if columns is None else path_of(columns)
    if path.suffix.lower() == ".parquet":
        mapping = load_columns(given) if given is not None else None
        needed = mapping and {TIME, *(each.column for each in mapping.values())}
        return make_table(path, *read_parquet(path, needed), mapping)
    if given is not None and is_profile(given):
        profile = load_profile(given)
        return _of_logger(open_table(path, profile.pivot), profile, further)
    mapping = load_columns(given) if given is not None else None
    raw = open_table(path)
    notes = Notes()
    is_own = raw.names[0] == TIME and (
        BY_NAME.keys() >= {*raw.names[1:]} or recognised_own(raw, notes) is None
    )
    if mapping is not None or is_own:
        cells = all_cells(raw, [Wanted(i) for i in range(len(raw.names))], notes)
        return _of_origin(make_table(path, list(raw.names), cells, mapping, notes))
    return _of_logger(raw, _of_model(raw, of_model) or recognised(raw, notes), further, notes)


def origin_of(table: Table) -> dict[str, Any]:
    """Return what the manifest of a table's copy in the own form keeps of a logger's file."""
    if not table.profile:
        return {}
    marked = {} if table.pinned is None else dict(zip(table.names, table.pinned.T, strict=True))
    columns = dict(zip(table.names, table.values.T, strict=True))
    pinned = {name: columns[name][rows] for name, rows in marked.items() if rows.any()}
    written = {n: sorted({float(f"{v:.9g}") for v in values}) for n, values in pinned.items()}
    return {"profile": table.profile, "pinned": written}


def _of_origin(table: Table) -> Table:
    """Return an own table with what its manifest keeps of the logger's file that it is made of.

    Raises RecordingError if that is no numbers by signal.
    """
    entry = entry_of(table.path)
    if not (entry.get("profile") and isinstance(pinned := entry.get("pinned"), dict)):
        return table
    columns = zip(table.names, table.values.T, strict=True)
    try:
        told = [(values, np.array(pinned.get(name, ()), dtype=float)) for name, values in columns]
    except (TypeError, ValueError):
        wanted = f"pinned of {table.path.name}: a list of numbers for each signal is wanted"
        raise RecordingError(f"{table.path.parent / NAME}: {wanted}") from None
    marks = [np.isin(*each) for each in told]
    return replace(table, profile=str(entry["profile"]), pinned=np.column_stack(marks))


def _of_model(raw: RawTable, tree: Mapping[str, Any] | None) -> Profile | None:
    """Return the profile of a model's card if the table has its time and output, else None."""
    if not tree:
        return None
    profile = profile_of(tree, Path("model.toml"))
    there = places(raw)
    needed = (profile.time, profile.signals.get(OUTPUT, ()))
    fits = all(any(key(source.column) in there for source in sources) for sources in needed)
    return profile if fits else None


def _of_logger(
    raw: RawTable, profile: Profile | None, further: Sequence[str], notes: Notes | None = None
) -> Table:
    """Return a logger's file as a table of canonical signals."""
    if profile is None:
        names = [name for name in raw.names if name]
        shown = ", ".join(names[:_SHOWN]) + (", …" if len(names) > _SHOWN else "")
        raise RecordingError(
            f"{raw.path}: no profile knows its columns ({shown}); give --profile NAME or FILE; "
            f"'o2mon check {raw.path} --write-profile FILE' writes one to edit"
        )
    return read_signals(raw, profile, further, notes)


def make_table(
    path: Path,
    header: Sequence[str],
    cells: FloatArray,
    columns: Mapping[str, Column] | None,
    notes: Notes | None = None,
) -> Table:
    """Return a table from its columns, (n, n_columns), under their canonical names.

    Raises RecordingError if a column is missing or twice there, or time falls.
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
    notes = notes or Notes()
    scaled = {}
    for name, each in columns.items():
        cell = cells[:, places[each.column]]
        neutral = each.factor == 1.0 and each.offset == 0.0
        scaled[name] = cell if neutral else cell * each.factor + each.offset
    time_s = scaled.pop(TIME)
    t_ns, last = _times(path, time_s, notes)
    names = tuple(scaled)
    values = np.column_stack([scaled[name] for name in names]) if names else cells[:, :0]
    return Table(path, names, t_ns, values if last.all() else values[last], notes=notes)


def _times(path: Path, time_s: FloatArray, notes: Notes) -> tuple[IntArray, BoolArray]:
    """Return rising times in ns, and of which rows (n,) they are: the last of equal times."""
    bad = np.flatnonzero(~(np.abs(time_s) < LATEST_S))
    if bad.size:
        raise RecordingError(f"{path}: line {bad[0] + 2}: {TIME} is not a number or no time in s")
    t_ns = in_ns(time_s)
    steps_ns = np.diff(t_ns)
    falling = np.flatnonzero(steps_ns < 0)
    if falling.size:
        row = int(falling[0]) + 1
        raise RecordingError(
            f"{path}: line {row + 2}: {TIME} is {time_s[row]:g} after {time_s[row - 1]:g}, "
            "rising times are wanted"
        )
    last = np.append(steps_ns > 0, True)
    notes.count("repeated_times", int((~last).sum()))
    return t_ns[last], last


def rename(table: Table) -> str:
    """Return how to name columns that are no canonical signals, "" if all are, or the sensor is."""
    known = {*table.names, *table.blank}
    if OUTPUT in known if table.profile else known <= BY_NAME.keys():
        return ""
    return (
        f"columns with other names? 'o2mon check {table.path} --write-profile FILE' proposes which "
        "is which signal, --profile FILE takes it"
    )


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
    """Return the sample period a table is used at: as asked, else its own.

    A table with uneven steps has the period nearest to its middle step, at least 100 ms.
    """
    return period_ns or uniform_period_ns(table.t_ns) or round_period_ns(table.t_ns)


def round_period_ns(t_ns: IntArray) -> int:
    """Return the round period that is nearest to the middle step of uneven times."""
    if len(t_ns) < 2:
        return DEFAULT_PERIOD_NS
    middle_ns = float(np.median(np.diff(t_ns)))
    return next((p for p in PERIODS_NS if p >= (1.0 - STEP_ABOVE) * middle_ns), PERIODS_NS[-1])
