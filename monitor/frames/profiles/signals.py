"""A raw table under a profile: canonical signals with their units, pinned values marked."""

import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from monitor.base.counts import counted
from monitor.base.errors import RecordingError
from monitor.base.signals import BY_NAME, OUTPUT
from monitor.base.types import BoolArray, FloatArray, IntArray
from monitor.frames.profiles.conversion import (
    Choice,
    converted,
    in_one_setting,
    is_of_quantity,
    may_be_absolute,
    stated_texts,
)
from monitor.frames.profiles.derived import derive
from monitor.frames.profiles.profile import Profile, Source, shipped, shipped_profile
from monitor.frames.profiles.recognition import key, places
from monitor.frames.profiles.times import cleaned, held, in_seconds
from monitor.frames.tables.raw_table import Notes, RawColumn, RawTable, Table, Wanted
from monitor.frames.tables.readers import reason
from monitor.frames.units import Unit, unit_of

# a running engine leaves none of these at 0: a column of zeros is a sensor that the car lacks
ALIVE: Final = frozenset(
    {"engine_speed_rpm", "maf_kg_h", "air_mass_mg", "fuel_mass_mg", "manifold_pressure_kpa"}
    | {"rail_pressure_mpa", "lambda_measured", "lambda_target", "lambda_controller"}
    | {"ambient_pressure_kpa", "battery_voltage_v", "volumetric_efficiency_percent"}
    | {"load_g_per_rev", "injector_pulse_width_ms", "vehicle_speed_km_h", "throttle_percent"}
)
PINNED_WITHIN: Final = 0.004  # of the value: readings have one decimal at 14.7, or two


def read_signals(
    raw: RawTable, profile: Profile, further: Sequence[str] = (), notes: Notes | None = None
) -> Table:
    """Return the canonical signals of a raw table.

    further : columns to read under their own names
    notes : oddities met so far
    A column whose unit is of another quantity than the signal's carries none.
    Raises RecordingError if no column tells the time, or the file has no rows.
    """
    there, notes = places(raw), notes or Notes()
    times = _times(raw, profile, there)
    choices = _choices(raw, profile, there, notes)
    own = [Choice(n, Source(column=n), there[key(n)][0]) for n in further if key(n) in there]
    t_ns, cells = _rows(raw, times, [*choices, *own], notes)
    doubted = [
        i
        for i, each in enumerate(choices if profile.name in shipped() else ())
        if may_be_absolute(each.source, raw.columns[each.column], cells[:, i])
    ]
    for i in doubted[::-1]:
        name = raw.names[choices.pop(i).column]
        notes.sentences.append(f"column {name}: a gauge pressure or an absolute one?")
    cells = np.delete(cells, doubted, axis=1)
    updates, told = np.count_nonzero(np.isfinite(cells), axis=0).tolist(), dict[str, int]()
    cells = held(cells, t_ns, [i for i, each in enumerate(choices) if each.name == OUTPUT])
    choices = in_one_setting(raw, profile, [(c, cells[:, i]) for i, c in enumerate(choices)])
    signals, pinned, columns = dict[str, FloatArray](), dict[str, BoolArray](), dict[str, str]()
    for i, each in enumerate((*choices, *own)):
        if each.name in signals or (i < len(choices) and not _lives(each.name, cells[:, i])):
            continue
        name = raw.names[each.column]
        if f"{name}#2" in raw.names:
            notes.sentences.append(f"of the columns {name} and {name}#2 the first is taken")
        columns[each.name] = f"column {name}"
        signals[each.name] = cells[:, i]
        if i < len(choices):
            signals[each.name], pinned[each.name] = _signal(raw, profile, each, cells[:, i])
        told[each.name] = updates[i]
    blank = {each.name: raw.names[each.column] for each in choices if each.name not in signals}
    for made, values in [*derive(signals, profile.engine)]:
        signals[made.name], columns[made.name] = values, f"made of {made.in_words}"
    order = [name for name in dict.fromkeys((*BY_NAME, *signals)) if name in signals]
    if not order:
        why = f"blank, or 0 throughout: {', '.join(blank.values())}; none other"
        known = f"is known to {profile.name}"
        raise RecordingError(f"{raw.path}: {why if blank else 'none of its columns'} {known}")
    nowhere = np.zeros(len(t_ns), dtype=bool)
    pins = np.column_stack([pinned.get(name, nowhere) for name in order])
    return Table(
        path=raw.path,
        names=tuple(order),
        t_ns=t_ns,
        values=np.column_stack([signals[name] for name in order]),
        pinned=pins if pins.any() else None,
        notes=notes,
        profile=profile.name,
        columns=columns,
        blank=blank,
        updates=told,
    )


def _times(raw: RawTable, profile: Profile, there: Mapping[str, list[int]]) -> list[Choice]:
    """Return the columns that may tell the time, the best first."""
    times = [
        Choice("time", each, there[key(each.column)][0])
        for each in profile.time
        if key(each.column) in there
    ]
    if not times:
        wanted = ", ".join(each.column for each in profile.time) or "none named"
        raise RecordingError(
            f"{raw.path}: no column of time ({wanted}) for the profile {profile.name}; "
            f"there are {', '.join(raw.names[:8])}{', …' if len(raw.names) > 8 else ''}"
        )
    return times


def _choices(
    raw: RawTable, profile: Profile, there: Mapping[str, list[int]], notes: Notes
) -> list[Choice]:
    """Return the columns of the profile's signals, the best first; units of others are noted."""
    choices, odd, signals = list[Choice](), dict[str, str](), dict(profile.signals)
    if profile.name in shipped() and not any(
        key(s.column) in there for s in signals.get(OUTPUT, ())
    ):
        others = map(shipped_profile, shipped())  # the sensor as another logger calls it
        signals[OUTPUT] = tuple(s for each in others for s in each.signals.get(OUTPUT, ()))
    for name, sources in signals.items():
        for source in sources:
            for place in there.get(key(source.column), ()):
                column = raw.columns[place]
                if is_of_quantity(name, source, column, profile.stoich_afr):
                    choices.append(Choice(name, source, place))
                    continue
                unit = " ".join(stated_texts(column))
                told = f"its unit {unit} does not suit {name} ({BY_NAME[name].unit})"
                odd.setdefault(name, f"column {column.name} is left out: {told}")
    named = {each.name for each in choices}
    notes.sentences += [told for name, told in odd.items() if name not in named]
    return choices


def _rows(
    raw: RawTable, times: Sequence[Choice], wanted: Sequence[Choice], notes: Notes
) -> tuple[IntArray, FloatArray]:
    """Return the rows' times in ns, (n,) strictly rising, and their cells, (n, n_wanted)."""
    sources, clocks = (*times, *wanted), _clocks(raw, times[0])
    parts, sizes = _parts(raw, times[0].column)
    columns = [Wanted(each.column, each.source.words) for each in sources]
    every = all_cells(raw, [*columns, *map(Wanted, clocks), *map(Wanted, parts)], notes)
    every[:, 0] = _joined(every[:, 0], every[:, len(columns) + len(clocks) :], sizes)
    steps = np.diff(_time(raw, times, every, Notes())[0])
    if 2 * np.count_nonzero(steps < 0.0) > len(steps):
        every = every[::-1]
        notes.sentences.append("the newest row stands first: read from the end")
    cells, ticks = every[:, len(times) : len(sources)], every[:, len(sources) :]
    time_s, wraps_s = _time(raw, times, every, notes)
    for i, each in enumerate(wanted):
        before = [place for place, clock in enumerate(clocks) if clock < each.column]
        if before and clocks[before[-1]] != times[0].column:
            cells[:, i] = _at(ticks[:, 0], ticks[:, before[-1]], cells[:, i])
    t_ns, rows = cleaned(time_s, wraps_s, notes)
    if len(t_ns) < 2:
        raise RecordingError(f"{raw.path}: {counted(len(t_ns), 'row')} with a time, two are wanted")
    return t_ns, cells[rows]


def _parts(raw: RawTable, time: int) -> tuple[list[int], FloatArray]:
    """Return the columns of hours, seconds, µs, … among which the time's stands, and their units.

    The units, (n,), are those of the time's column.
    """
    named = [unit_of(column.name, 1.0) for column in raw.columns]
    sizes = [unit.factor if unit and unit.quantity == "time" else 0.0 for unit in named]
    sizes[time] = sizes[time] or float(raw.columns[time].kind == "clock")
    runs = np.cumsum([not before > after > 0.0 for before, after in pairwise([0.0, *sizes])])
    places = np.flatnonzero(runs == runs[time]).tolist()
    return places, np.array(sizes)[places] / (sizes[time] or 1.0)


def _joined(time: FloatArray, parts: FloatArray, sizes: FloatArray) -> FloatArray:
    """Return the times, (n,), that columns hold together, or the time's own if these are others."""
    tops = np.nanmax(parts[:, 1:], axis=0, initial=0.0) * sizes[1:]
    is_whole = np.all((parts == np.floor(parts)) | np.isnan(parts), axis=0)
    are_parts = len(sizes) > 1 and is_whole[:-1].all() and (tops < sizes[:-1]).all()
    return np.asarray(parts @ sizes) if are_parts else time


def _clocks(raw: RawTable, time: Choice) -> list[int]:
    """Return the columns that are clocks of the columns behind them, as the time's is.

    Their names are the time's but for a number, or begin as it and stand before each other column.
    """
    first = time.column
    alike, kin = (
        [i for i, each in enumerate(bare) if each == bare[first]]
        for form in (r"#?\d+", r"[\W\d_].*")
        for bare in [[re.sub(form, "", name) for name in raw.names]]
    )
    clocks = kin if kin == [*range(first, len(raw.names), 2)] else alike
    return clocks if len(clocks) > 1 and min(np.diff(clocks)) > 1 else []


def _at(times: FloatArray, own: FloatArray, cells: FloatArray) -> FloatArray:
    """Return the values of a column with its own clock at the first of other times behind each.

    A clock rises in most rows and falls no oftener than the others; behind another column, such as
    t_oil, the values are those of their rows.
    """
    others, steps = (np.diff(each[np.isfinite(each)]) for each in (times, own))
    is_odd = np.count_nonzero(steps < 0.0) > np.count_nonzero(others < 0.0)
    if is_odd or 2 * np.count_nonzero(steps > 0.0) < len(steps):
        return cells
    known = np.flatnonzero(np.isfinite(own) & np.isfinite(cells))
    order = known[np.argsort(own[known], kind="stable")]
    place = np.searchsorted(own[order], times, side="right") - 1
    is_new = np.diff(place, prepend=-1) > 0
    return np.where(is_new, cells[order][np.maximum(place, 0)], np.nan) if len(order) else cells


def _lives(name: str, cells: FloatArray) -> bool:
    """Return whether a column holds values, and not zeros where a running engine has none."""
    known = np.isfinite(cells)
    return bool((known & (cells != 0.0)).any() if name in ALIVE else known.any())


def all_cells(raw: RawTable, wanted: Sequence[Wanted], notes: Notes) -> FloatArray:
    """Return all rows of the wanted columns, (n, n_wanted).

    Raises RecordingError if the file cannot be read or has no rows.
    """
    try:
        blocks = list(raw.read(wanted, notes))
    except RecordingError:
        raise
    except Exception as error:  # a damaged file fails in many ways
        raise RecordingError(f"{raw.path}: cannot read it: {reason(error)}") from error
    if not blocks:
        raise RecordingError(f"{raw.path}: the log has no rows")
    return np.concatenate(blocks)


def _time(
    raw: RawTable, times: Sequence[Choice], cells: FloatArray, notes: Notes
) -> tuple[FloatArray, float]:
    """Return the times in s, and after which time they wrap."""
    for place, each in enumerate(times):
        column = raw.columns[each.column]
        values = cells[:, place]
        if not np.isfinite(values).any():
            continue
        if column.kind == "clock":
            return values, column.wraps_s
        if unit := _time_unit(column, each.source):
            return values * unit.factor, 0.0
        if each.source.factor != 1.0:
            return values * each.source.factor, 0.0
        values_s, per_s = in_seconds(values, are_counts=any(stated_texts(column)))
        if not per_s:
            step = np.median(np.diff(values[np.isfinite(values)]))
            raise RecordingError(
                f"{raw.path}: the times of column {column.name} have no unit and go up by "
                f'{step:g}: in a profile say time = {{ column = "{column.name}", unit = "ms" }}, '
                'or unit = "s", or factor = the seconds of one count'
            )
        if per_s != 1.0:
            notes.sentences.append(f"column {column.name}: no unit, taken for 1/{per_s:g} s")
        return values_s, 0.0
    names = ", ".join(raw.columns[each.column].name for each in times)
    raise RecordingError(f"{raw.path}: no number in the column of time ({names})")


def _time_unit(column: RawColumn, source: Source) -> Unit | None:
    """Return the unit of time that the file, the profile or the name (``time_ms``) states."""
    texts = (*stated_texts(column), *source.units, column.name.rpartition("_")[2])
    units = (unit_of(text, 1.0) for text in texts)
    return next((unit for unit in units if unit and unit.quantity == "time"), None)


def _signal(
    raw: RawTable, profile: Profile, choice: Choice, cells: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return a column in the signal's unit, and where it says that there is no sensor."""
    column, source = raw.columns[choice.column], choice.source
    pinned = np.zeros(len(cells), dtype=bool)
    for value in source.pinned:
        pinned |= np.abs(cells - value) <= PINNED_WITHIN * max(abs(value), 1e-3)
    if source.is_flag:
        values = _flag(source, cells)
    else:
        values = converted(profile, choice, column, cells)
        values = values * source.factor + source.offset
        if BY_NAME[choice.name].unit == "-":  # no mixture is below 0: loggers write -1 for no value
            values = np.where(values < 0.0, np.nan, values)
    if source.inverted:
        values = 1.0 - values
    return values, pinned


def _flag(source: Source, cells: FloatArray) -> FloatArray:
    """Return 1 where the source's test holds, else 0; NaN where there is no value."""
    above = 0.5 if source.words else source.above
    holds = np.isin(cells, source.equals) if above is None else cells > above
    if source.bit is not None:
        whole = np.where(np.isfinite(cells), cells, 0.0).astype(np.int64)
        holds = (whole >> source.bit) & 1 == 1
    return np.where(np.isfinite(cells), holds.astype(np.float64), np.nan)
