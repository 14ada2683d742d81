"""A profile to edit, for a logger that no shipped profile knows.

Columns whose names shipped profiles know are proposed, and columns whose words, unit and values say
which signal they are. All others stand in comments with their unit and range, so that the user sees
what there is.
"""

import json
from collections.abc import Collection, Iterator, Sequence

import numpy as np

from monitor.base.signals import SIGNALS, plausible_range
from monitor.base.types import FloatArray
from monitor.frames.profiles.conversion import scaled, stated_texts, target_of
from monitor.frames.profiles.profile import ProfileEngine, Source, shipped, shipped_profile
from monitor.frames.profiles.recognition import key, keys_of
from monitor.frames.profiles.units import unit_of
from monitor.frames.tables.dialect import name_and_unit
from monitor.frames.tables.raw_table import Notes, RawColumn, RawTable, Wanted
from monitor.mapping.candidates import elsewhere, is_other
from monitor.mapping.meanings import MEANINGS, OF_ONE_SENSOR
from monitor.mapping.proposal import SURE
from monitor.mapping.scaling import STOICHIOMETRIC
from monitor.mapping.vocabulary import match, words_of

_ENOUGH = 6  # columns to know a logger by
_OWN = 3  # of these, columns that no shipped profile knows: others may be another logger's, too
_INVERSE = {"phi"}  # 1 / lambda, which no factor of a profile makes lambda
_TIMES = ("time", "timestamp", "zeit", "seconds", "elapsedtime", "logtime", "devicetime")


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
    taken = {column for column, _ in found.values()} | set(times)
    for name, named in _by_words(raw, cells, taken, [n for n in names if n not in found]):
        found[name] = named, Source(column=named)
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
    yield from _engine(found)
    yield "# columns that are not used:"
    for i, column in enumerate(raw.columns):
        if column.name and column.name not in used:
            yield f"# {_quoted(column.name)}{_range(column.unit, cells[:, i])}"
    yield "# signals without a column:"
    for name, signal in names.items():
        if name not in found:
            yield f'# {name} = {{ column = "", unit = "{signal.unit}" }}'


def _engine(found: Collection[str]) -> Iterator[str]:
    """Yield what derived signals need to know of the engine, with the defaults, in comments."""
    own = ProfileEngine()
    if "injector_pulse_width_ms" in found:
        yield "# [engine]            # for the fuel mass; a model's gain takes up an error"
        yield f"# injector_mg_per_ms = {own.injector_mg_per_ms:g}"
        yield f"# injector_dead_time_ms = {own.injector_dead_time_ms:g}   # at 14 V"
        yield ""
    elif "fuel_cut" not in found and "manifold_pressure_kpa" in found:
        yield "# [engine]            # no column tells fuel cuts: the pressure may"
        yield "# overrun_below_kpa = 22.0   # below that of idle; 0: never"
        yield f"# overrun_above_rpm = {own.overrun_above_rpm:g}"
        yield ""


def _known_names() -> dict[str, tuple[str, Source]]:
    """Return signal and source by the key of a column, of all shipped profiles."""
    known: dict[str, tuple[str, Source]] = {}
    for name in shipped():
        for signal, sources in shipped_profile(name).signals.items():
            for source in sources:
                known.setdefault(key(source.column), (signal, source))
    return known


def _by_words(
    raw: RawTable, cells: FloatArray, taken: Collection[str], wanted: Sequence[str]
) -> Iterator[tuple[str, str]]:
    """Yield signals and the columns that name them; none where two columns do so equally well."""
    free = [i for i, column in enumerate(raw.columns) if column.name and column.name not in taken]
    sure = [
        (_sureness(name, raw.columns[i], cells[:, i]), name, raw.names[i])
        for name in wanted
        if name in MEANINGS
        for i in free
    ]
    done: set[str] = set()
    for confidence, name, column in sorted(sure, reverse=True):
        if confidence < SURE:
            return
        rivals = [c for c, n, other in sure if n == name and other != column and c == confidence]
        if not done & {name, column} and not rivals:
            yield name, column
        done |= {name, column}


def _sureness(name: str, column: RawColumn, cells: FloatArray) -> float:
    """Return how sure a column's words are of a signal, 0 if its unit or values are others."""
    meaning, text = MEANINGS[name], name_and_unit(column.name)[0]
    words = words_of(text)
    if _INVERSE & set(words):
        return 0.0
    if is_other(meaning, words) or any(word.isdigit() and int(word) > 1 for word in words):
        return 0.0
    if name in OF_ONE_SENSOR and elsewhere((text,)):
        return 0.0
    target = target_of(name, STOICHIOMETRIC)
    stated = [unit for each in stated_texts(column) if (unit := unit_of(each, STOICHIOMETRIC))]
    unit = stated[0] if stated else target
    known = cells[np.isfinite(cells)]
    if target is None or unit is None or unit.quantity != target.quantity or not len(known):
        return 0.0
    low, high = plausible_range(name)
    is_plausible = low <= float(np.median(scaled(known, unit, target))) <= high
    return match(meaning.phrases, words) if is_plausible else 0.0


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
