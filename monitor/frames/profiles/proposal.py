"""A profile to edit, for a logger that no shipped profile knows.

Columns whose names shipped profiles know are proposed; all others stand in comments with their unit
and range, so that the user sees what there is.
"""

import json
from collections.abc import Iterator

import numpy as np

from monitor.base.signals import SIGNALS
from monitor.base.types import FloatArray
from monitor.frames.profiles.profile import Source, shipped, shipped_profile
from monitor.frames.profiles.recognition import key, keys_of
from monitor.frames.tables.dialect import name_and_unit
from monitor.frames.tables.raw_table import Notes, RawTable, Wanted

_ENOUGH = 6  # columns to know a logger by
_OWN = 3  # of these, columns that no shipped profile knows: others may be another logger's, too
_TIMES = ("time", "timestamp", "seconds", "elapsedtime", "logtime", "devicetime")


def proposed(raw: RawTable) -> Iterator[str]:
    """Yield the lines of a profile for a raw table."""
    names = {signal.name: signal for signal in SIGNALS}
    known = _known_names()
    notes = Notes()
    wanted = [Wanted(i) for i in range(len(raw.columns))]
    cells = next(iter(raw.read(wanted, notes)), np.empty((0, len(wanted))))
    found: dict[str, tuple[str, Source]] = {}
    for column in raw.columns:
        for each in keys_of(column.name):
            if each in known and known[each][0] not in found:
                found[known[each][0]] = column.name, known[each][1]
    times = _time_columns(raw, cells)
    yield f'title = "{raw.path.stem}"'
    yield "# stoich_afr = 14.7   # of the fuel: 9.0 for E85"
    yield f"time = [{', '.join(map(_quoted, times))}]{'' if times else '   # which column?'}"
    yield ""
    yield "[[recognise]]         # a file with all these columns is read with this profile"
    used = {column for column, _ in found.values()} | set(times)
    own = [name for name in raw.names if name and name not in used][:_OWN]
    chosen = [*times[:1], *own, *(column for column, _ in found.values()), *raw.names]
    yield f"columns = [{', '.join(map(_quoted, list(dict.fromkeys(chosen))[:_ENOUGH]))}]"
    yield ""
    yield "[signals]             # canonical name = column; unit where the file states none"
    for name in names:
        if name in found:
            yield f"{name} = {_source(*found[name])}"
    yield ""
    yield "# columns that are not used:"
    for i, column in enumerate(raw.columns):
        if column.name and column.name not in used:
            yield f"# {_quoted(column.name)}{_range(column.unit, cells[:, i])}"
    yield "# signals without a column:"
    for name, signal in names.items():
        if name not in found:
            yield f'# {name} = {{ column = "", unit = "{signal.unit}" }}'


def _known_names() -> dict[str, tuple[str, Source]]:
    """Return signal and source by the key of a column, of all shipped profiles."""
    known: dict[str, tuple[str, Source]] = {}
    for name in shipped():
        for signal, sources in shipped_profile(name).signals.items():
            for source in sources:
                known.setdefault(key(source.column), (signal, source))
    return known


def _time_columns(raw: RawTable, cells: FloatArray) -> list[str]:
    """Return the columns that tell the time: by name, as clocks, else the first that rises."""
    clocks = [column.name for column in raw.columns if column.kind == "clock"]
    named = [name for name in raw.names if key(name_and_unit(name)[0]) in _TIMES]
    if not (named or clocks):
        steps = np.diff(cells, axis=0)
        rises = (steps >= 0.0).all(axis=0) & (steps > 0.0).any(axis=0)
        named = [raw.names[i] for i in np.flatnonzero(rises).tolist()][:1]
    return list(dict.fromkeys((*named, *clocks)))


def _source(column: str, known: Source) -> str:
    """Return a source in TOML: the known one under the column's own name."""
    parts = [f"column = {_quoted(column)}"]
    if known.units:
        units = [_quoted(unit) for unit in known.units]
        parts.append(f"unit = {units[0] if len(units) == 1 else '[' + ', '.join(units) + ']'}")
    for name in ("factor", "offset"):
        value = getattr(known, name)
        if value != (1.0 if name == "factor" else 0.0):
            parts.append(f"{name} = {value:g}")
    if known.pinned:
        parts.append(f"pinned = [{', '.join(f'{value:g}' for value in known.pinned)}]")
    return _quoted(column) if len(parts) == 1 else f"{{ {', '.join(parts)} }}"


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _range(unit: str, cells: FloatArray) -> str:
    known = cells[np.isfinite(cells)]
    span = f" {known.min():g} to {known.max():g}" if len(known) else " no number"
    return f"{' ' + unit if unit else ''}{span}"
