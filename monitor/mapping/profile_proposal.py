"""A profile to edit, for a logger that no shipped profile knows.

Columns whose names shipped profiles know are proposed, and columns whose words, unit and values say
which signal they are. All others stand in comments with their unit and range, so that the user sees
what there is.
"""

import json
from collections.abc import Collection, Iterator, Sequence

import numpy as np

from monitor.base.signals import OUTPUT, SIGNALS, plausible_range
from monitor.base.types import FloatArray
from monitor.frames.profiles.conversion import is_of_quantity, scaled, stated_texts, target_of
from monitor.frames.profiles.profile import ProfileEngine, Source, shipped, shipped_profile
from monitor.frames.profiles.recognition import key, keys_of
from monitor.frames.profiles.signals import ALIVE
from monitor.frames.tables.dialect import name_and_unit
from monitor.frames.tables.raw_table import Notes, RawColumn, RawTable, Wanted
from monitor.frames.units import Unit, unit_of
from monitor.mapping.candidates import elsewhere
from monitor.mapping.proposal import SURE
from monitor.mapping.quantities import OF_ONE_SENSOR, QUANTITIES, STOICHIOMETRIC
from monitor.mapping.words import match, words_of

_ENOUGH = 6  # columns to know a logger by
_OWN = 3  # of these, columns that no shipped profile knows: others may be another logger's, too
_INVERSE = {"phi"}  # 1 / lambda, which no factor of a profile makes lambda
_TIMES = ("time", "timestamp", "zeit", "seconds", "elapsedtime", "logtime", "devicetime")
_RISING = 0.95  # of the steps of a column that tells the time; the first row may be an old one
_COMMAND = "req request requested target cmd commanded desired soll sp"
_COMMANDED = frozenset(_COMMAND.split())
_STATES = frozenset(("status", "state", "on", "active"))  # of a flag, no measurement
_CORRECTED = "mod modifier mult multiplier corr correction trim adj comp"
_CORRECTIONS = frozenset(_CORRECTED.split())
_STEADY = frozenset(  # may stand still while the engine runs
    ("lambda_target", "ambient_pressure_kpa", "battery_voltage_v", "vehicle_speed_km_h")
) | {"throttle_percent", "volumetric_efficiency_percent"}


def proposed(raw: RawTable) -> Iterator[str]:
    """Yield the lines of a profile for a raw table."""
    names = {signal.name: signal for signal in SIGNALS}
    notes = Notes()
    wanted = [Wanted(i) for i in range(len(raw.columns))]
    cells = next(iter(raw.read(wanted, notes)), np.empty((0, len(wanted))))
    found: dict[str, tuple[str, Source]] = {}
    _take_known(raw, cells, found, as_it_is=True)
    times = _time_columns(raw, cells)
    taken = {column for column, _ in found.values()} | set(times)
    for name, by_words in _by_words(raw, cells, taken, [n for n in names if n not in found]):
        column = raw.columns[raw.names.index(by_words)]
        assumed = () if any(stated_texts(column)) else _assumed(name, by_words)
        found[name] = by_words, Source(column=by_words, units=assumed)
    _take_known(raw, cells, found, as_it_is=False)
    yield f'title = "{raw.path.stem}"'
    yield "# stoich_afr = 14.7   # of the fuel: 9.0 for E85"
    yield f"time = [{', '.join(map(_quoted, times))}]{'' if times else '   # which column?'}"
    yield ""
    yield "[[recognise]]         # a file with all these columns is read with this profile"
    used = {column for column, _ in found.values()} | set(times)
    named = list(filter(None, raw.names))
    own = [name for name in named if name not in used][:_OWN]
    chosen = [*times[:1], *own, *(column for column, _ in found.values()), *named]
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


def _take_known(
    raw: RawTable, cells: FloatArray, found: dict[str, tuple[str, Source]], *, as_it_is: bool
) -> None:
    """Add the columns that shipped profiles know for signals without one, the first of each.

    as_it_is : only those without a factor or an offset, such as of a gauge pressure
    """
    known = _known_names()
    for i, column in enumerate(raw.columns):
        for each in keys_of(column.name):
            name, source = known.get(each, ("", Source(column="")))
            if (
                name
                and name not in found
                and not (as_it_is and (source.factor, source.offset) != (1.0, 0.0))
                and is_of_quantity(name, source, column, STOICHIOMETRIC)
                and not _is_doubtful(name, column, cells[:, i])
            ):
                found[name] = column.name, source


def _by_words(
    raw: RawTable, cells: FloatArray, taken: Collection[str], wanted: Sequence[str]
) -> Iterator[tuple[str, str]]:
    """Yield signals and the columns that name them; none where two columns do so equally well."""
    free = [i for i, column in enumerate(raw.columns) if column.name and column.name not in taken]
    sure = [
        (_sureness(name, raw.columns[i], cells[:, i]), name, raw.names[i])
        for name in wanted
        if name in QUANTITIES
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
    texts = [name_and_unit(each)[0] for each in (column.name, *column.others)]
    return max(_of_text(name, column, cells, text) for text in texts)


def _of_text(name: str, column: RawColumn, cells: FloatArray, text: str) -> float:
    quantity, words = QUANTITIES[name], words_of(text)
    target = target_of(name, STOICHIOMETRIC)
    known = cells[np.isfinite(cells)]
    if (
        _INVERSE & set(words)
        or (name in OF_ONE_SENSOR and elsewhere((text,)))
        or _is_doubtful(name, column, cells)
        or not is_of_quantity(name, Source(column=column.name), column, STOICHIOMETRIC)
        or target is None
        or not len(known)
    ):
        return 0.0
    stated = _units(stated_texts(column))
    unit = stated[0] if stated else next(iter(_units(_assumed(name, text))), target)
    low, high = plausible_range(name)
    if unit.quantity != target.quantity or not (
        low <= float(np.median(scaled(known, unit, target))) <= high
    ):
        return 0.0
    says_lambda = name == OUTPUT and unit.factor != 1.0  # an air/fuel ratio
    sure, rest = match(quantity.phrases, words)
    says_flow = name == "maf_kg_h" and bool(stated) and "flow" in words
    if not quantity.also.issuperset(rest):
        return SURE if says_lambda else 0.0
    return max(sure, SURE if says_lambda or says_flow else 0.0)


def _assumed(name: str, text: str) -> tuple[str, ...]:
    """Return the unit that a column's name tells where the file states none."""
    says_afr = any(each in text.casefold() for each in ("afr", "a/f", "air/fuel"))
    return ("AFR",) if says_afr and name in ("lambda_measured", "lambda_target") else ()


def _units(texts: Sequence[str]) -> list[Unit]:
    return [unit for text in texts if (unit := unit_of(text, STOICHIOMETRIC))]


def _is_doubtful(name: str, column: RawColumn, cells: FloatArray) -> bool:
    """Return whether a column is no measurement: commanded, a correction, or one constant value."""
    words = {w for text in (column.name, *column.others) for w in words_of(name_and_unit(text)[0])}
    commanded = bool(words & _COMMANDED) and not name.endswith("_target")
    corrected = bool(words & _CORRECTIONS) and not name.startswith(("lambda_con", "lambda_corr"))
    state = bool(words & _STATES) and not (name in QUANTITIES and QUANTITIES[name].is_flag)
    known = cells[np.isfinite(cells)]
    constant = len(known) > 1 and bool((known == known[0]).all())
    return commanded or corrected or state or (constant and name in ALIVE - _STEADY)


def _time_columns(raw: RawTable, cells: FloatArray) -> list[str]:
    """Return the columns that tell the time: by name, as clocks, else the first that rises."""
    clocks = [column.name for column in raw.columns if column.kind == "clock"]
    named = [name for name in raw.names if key(name_and_unit(name)[0]) in _TIMES]
    if not (named or clocks):
        steps = np.diff(cells, axis=0)
        rises = ((steps >= 0.0).mean(axis=0) > _RISING) & (np.median(steps, axis=0) > 0.0)
        rises &= ~(steps == 1.0).all(axis=0)  # a counter of rows is no time
        named = [raw.names[i] for i in np.flatnonzero(rises).tolist() if raw.names[i]][:1]
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
