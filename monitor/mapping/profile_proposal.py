"""A profile to edit, for a logger that no shipped profile knows.

Columns whose names shipped profiles know are proposed, and columns whose words, unit and values say
which signal they are. All others stand in comments with their unit and range, so that the user sees
what there is.
"""

from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from typing import Final

import numpy as np

from monitor.base.counts import plain
from monitor.base.signals import BY_NAME, SIGNALS
from monitor.base.types import FloatArray
from monitor.frames.profiles.conversion import is_of_quantity, stated_unit
from monitor.frames.profiles.profile import (
    ProfileEngine,
    Source,
    shipped,
    shipped_profile,
    source_tree,
)
from monitor.frames.profiles.recognition import key, keys_of
from monitor.frames.tables.dialect import name_and_unit
from monitor.frames.tables.raw_table import Notes, RawColumn, RawTable, Wanted
from monitor.frames.units import unit_of
from monitor.mapping.fit import Description, QuantityFit, fit_of
from monitor.mapping.quantities import QUANTITIES, STOICHIOMETRIC, VARYING
from monitor.mapping.text import toml

_ENOUGH: Final = 6  # columns to know a logger by
_OWN: Final = 3  # of these, columns that no shipped profile knows: no other logger has them
_TIMES: Final = (
    *("t", "time", "timestamp", "zeit", "temps", "tempo", "tiempo", "seconds", "elapsedtime"),
    *("logtime", "devicetime"),
)
_RISING: Final = 0.95  # of the steps of a time's column; the first row may be an old one
_KNOWN, _CONVERTED = 2.0, 0.5  # how sure a known name is: of the quantity, of a gauge pressure


def proposed(raw: RawTable) -> Iterator[str]:
    """Yield the lines of a profile for a raw table."""
    wanted = [Wanted(i) for i in range(len(raw.columns))]
    cells = next(iter(raw.read(wanted, Notes())), np.empty((0, len(wanted))))
    times = _time_columns(raw, cells)
    found = _found(raw, cells, times)
    used = {source.column for source in found.values()} | set(times)
    yield f'title = "{raw.path.stem}"'
    yield "# stoich_afr = 14.7   # of the fuel: 9.8 for E85"
    yield f"time = {toml(times)}{'' if times else '   # which column?'}"
    yield ""
    yield "[[recognise]]         # a file with all these columns is read with this profile"
    named = list(filter(None, raw.names))
    own = [name for name in named if name not in used][:_OWN]
    chosen = [*times[:1], *own, *(source.column for source in found.values()), *named]
    yield f"columns = {toml(list(dict.fromkeys(chosen))[:_ENOUGH])}"
    yield ""
    yield "[signals]             # canonical name = column; unit where the file states none"
    yield from (f"{s.name} = {_source(found[s.name])}" for s in SIGNALS if s.name in found)
    yield ""
    yield "# [engine]            # for signals that no column has; 0 kPa: no fuel cut by pressure"
    yield from (f"# {each.name} = {each.default}" for each in fields(ProfileEngine))
    yield ""
    yield "# columns that are not used:"
    for i, column in enumerate(raw.columns):
        if column.name and column.name not in used:
            known = cells[np.isfinite(cells[:, i]), i]
            span = (
                f"{plain(known.min(), 6)} to {plain(known.max(), 6)}" if len(known) else "no number"
            )
            yield "# " + " ".join(filter(None, (toml(column.name), column.unit, span)))
            yield from _doubts(column, known, found)
    yield "# signals without a column:"
    for signal in SIGNALS:
        if signal.name not in found:
            yield f'# {signal.name} = {{ column = "", unit = "{signal.unit}" }}'


def _found(raw: RawTable, cells: FloatArray, times: list[str]) -> dict[str, Source]:
    """Return a column for each signal, the surest first; none where two say it equally well."""
    offers = sorted(_offers(raw, cells), key=lambda offer: (-offer[0], offer[1]))
    found: dict[str, Source] = {}
    done = set(times)
    for sure, i, name, source in offers:
        rivals = {o[1] for o in offers if (o[0], o[2]) == (sure, name)} - {i}
        if not done & {name, source.column} and (sure >= _KNOWN or not rivals):
            found[name] = source
        done |= {name, source.column}
    return found


def _offers(raw: RawTable, cells: FloatArray) -> Iterator[tuple[float, int, str, Source]]:
    """Yield how sure a column, by its number, is of a signal, and how a profile names it."""
    known: dict[str, list[tuple[str, Source]]] = {}
    for profile in map(shipped_profile, shipped()):
        for name, sources in profile.signals.items():
            for source in sources:
                known.setdefault(key(source.column), []).append((name, source))
    for i, column in enumerate(raw.columns):
        values = cells[:, i]
        if not column.name or not np.isfinite(values).any():
            continue
        for name, source in (known[each][0] for each in keys_of(column.name) if each in known):
            own = _known(name, source, column, values)
            if own and (name not in VARYING or np.nanmax(values) > np.nanmin(values)):
                yield _KNOWN if (own.factor, own.offset) == (1.0, 0.0) else _CONVERTED, i, name, own
        for text in dict.fromkeys(name_and_unit(each)[0] for each in (column.name, *column.others)):
            described = Description(text, stated_unit(column, STOICHIOMETRIC), values=values)
            for name in BY_NAME.keys() & QUANTITIES.keys():
                fit = fit_of(name, described)
                if fit and fit.stands and not fit.is_phi:
                    yield fit.confidence, i, name, _by_words(name, column, fit)


def _doubts(column: RawColumn, values: FloatArray, found: Mapping[str, Source]) -> Iterator[str]:
    """Yield why a column is not the signal that it looks like most, if no other column is."""
    text, unit = name_and_unit(column.name)[0], stated_unit(column, STOICHIOMETRIC)
    fits = ((n, fit_of(n, Description(text, unit, values=values))) for n in QUANTITIES)
    doubted = [(fit.confidence, n, fit.doubts[0]) for n, fit in fits if fit and fit.doubts]
    if len(values) and doubted and (best := max(doubted))[1] not in found:
        yield f"#   {best[1]}? {best[2]}"


def _known(name: str, source: Source, column: RawColumn, values: FloatArray) -> Source | None:
    """Return a shipped profile's source for a column, None if unit or values are of another one.

    Where neither file nor profile states a unit, the values tell it.
    """
    own = replace(source, column=column.name)
    if not is_of_quantity(name, source, column, STOICHIOMETRIC):
        return None
    stated = stated_unit(column, STOICHIOMETRIC)
    converts = own != Source(column=own.column, units=own.units, pinned=own.pinned)
    if name not in QUANTITIES or converts:
        return own
    unit = stated or (own.units[0] if len(own.units) == 1 else "")  # else a setting
    fit = fit_of(name, Description(column.name, unit, values=values), is_named=True)
    if not unit:
        return _by_words(name, column, fit) if fit and fit.stands else None
    return own if fit and fit.stands else None


def _by_words(name: str, column: RawColumn, fit: QuantityFit) -> Source:
    """Return the source of a column that no profile knows; what its file states needs no word."""
    stated = unit_of(stated_unit(column, STOICHIOMETRIC), STOICHIOMETRIC)
    if stated and stated.quantity == QUANTITIES[name].unit.quantity:
        return Source(column=column.name)
    if fit.unit:
        return Source(column=column.name, units=(fit.unit,))
    return Source(column=column.name, factor=fit.factor, offset=fit.offset)


def _time_columns(raw: RawTable, cells: FloatArray) -> list[str]:
    """Return the columns that tell the time: by name, as clocks, else the first that rises."""
    clocks = [column.name for column in raw.columns if column.kind == "clock"]
    named = [name for name in raw.names if key(name_and_unit(name)[0]) in _TIMES]
    if not (named or clocks) and len(cells) > 1:
        steps = np.diff(cells, axis=0)
        units = [unit_of(stated_unit(column, STOICHIOMETRIC), 1.0) for column in raw.columns]
        kinds = [unit.quantity if unit else "" for unit in units]
        in_time, unstated = (np.array([kind == each for kind in kinds]) for each in ("time", ""))
        rises = ((steps >= 0.0).mean(axis=0) > _RISING) & (np.median(steps, axis=0) > 0.0)
        rises &= ~(steps == 1.0).all(axis=0)  # a counter of rows is no time
        rises[[i for _, i, *_ in _offers(raw, cells)]] = False  # signals
        rises &= in_time if (rises & in_time).any() else unstated
        named = [raw.names[i] for i in np.flatnonzero(rises).tolist() if raw.names[i]][:1]
    return list(dict.fromkeys((*named, *clocks)))


def _source(source: Source) -> str:
    """Return a source in TOML, as its column alone if that says all."""
    tree = source_tree(source) | ({"unit": source.units[0]} if len(source.units) == 1 else {})
    return toml(tree if len(tree) > 1 else source.column)
