"""A profile to edit, for a logger that no shipped profile knows.

Columns whose names shipped profiles know are proposed, and columns whose words, unit and values say
which signal they are. All others stand in comments with their unit and range, so that the user sees
what there is.
"""

from collections.abc import Collection, Iterator
from dataclasses import fields, replace
from importlib.resources import files
from typing import Final

import numpy as np

from monitor.base.counts import plain
from monitor.base.signals import BY_NAME, SIGNALS, plausible_range
from monitor.base.types import FloatArray
from monitor.frames.profiles.conversion import is_of_quantity, may_be_absolute, stated_unit
from monitor.frames.profiles.profile import (
    STOICH_AFR,
    ProfileEngine,
    Source,
    shipped,
    shipped_profile,
    source_tree,
)
from monitor.frames.profiles.recognition import key, keys_of
from monitor.frames.tables.dialect import name_and_unit
from monitor.frames.tables.raw_table import Notes, RawColumn, RawTable, Wanted
from monitor.frames.units import UNITS, unit_of
from monitor.mapping.fit import SEVERAL, SURE, Description, QuantityFit, fit_of
from monitor.mapping.proposal import Entry, SignalCandidate, entries, propose, toml
from monitor.mapping.vocabulary import QUANTITIES, WORDS, match, words_of
from monitor.report.check_table import TableCheck

_ENOUGH: Final = 6  # columns to know a logger by
_OWN: Final = 3  # of these, columns that no shipped profile knows: no other logger has them
_RISING: Final = 0.95  # of the steps of a time's column; the first row may be an old one
_TEMPERATURES: Final = [n for n, q in QUANTITIES.items() if q.unit.quantity == "temperature"]
_PROFILE: Final = files("monitor.mapping").joinpath("profile.template").read_text("utf-8")


def proposed(raw: RawTable) -> str:
    """Return the text of a profile for a raw table."""
    wanted = [Wanted(i) for i in range(len(raw.columns))]
    cells = next(iter(raw.read(wanted, Notes())), np.empty((0, len(wanted))))
    candidates = _candidates(raw, cells)
    coolant = propose(candidates)["coolant_temperature_degc"].best
    setting = coolant.entry.get("unit") if coolant and isinstance(coolant.entry, dict) else None
    if isinstance(setting, str):  # one for all; of several the file states which
        candidates = _candidates(raw, cells, setting)
    looks = {c.place for each in candidates.values() for c in each if not c.fit.doubt}
    times = _time_columns(raw, cells, looks)
    others = {name: [c for c in each if c.place not in times] for name, each in candidates.items()}
    proposals = list(propose(others).values())
    used = [c.place for c in sorted((p.best for p in proposals if p.best), key=lambda c: c.rank)]
    named = list(filter(None, raw.names))
    own = [name for name in named if name not in {*times, *used}]
    columns = dict.fromkeys((*times[:1], *own[:_OWN], *used, *named))
    return _PROFILE.format(
        title=toml(raw.path.stem),
        times=f"{toml(times)}{'' if times else '   # which column?'}",
        columns=toml(list(columns)[:_ENOUGH]),
        signals="\n".join(entries(proposals)),
        engine="\n".join(f"# {each.name} = {each.default}" for each in fields(ProfileEngine)),
        unused="\n".join(
            _told(column, cells[:, i]) for i, column in enumerate(raw.columns) if column.name in own
        ),
    )


def unusual(check: TableCheck) -> Iterator[str]:
    """Yield a line for each signal whose median no running engine has: perhaps in another unit."""
    for name, column in zip(check.table.names, check.table.values.T, strict=True):
        if name not in QUANTITIES:
            continue
        values = column[check.runs & np.isfinite(column)]
        middle = float(np.median(values)) if len(values) else np.nan
        (low, high), kind = QUANTITIES[name].usual, QUANTITIES[name].unit.quantity
        is_above = middle > high and kind in ("temperature", "lambda")
        if is_above or (middle < low and name in WORDS["varying"]):
            told = f"{plain(middle)} is unusual for an engine that runs"
            yield f"note: {name}: a median of {told}, {low:g} to {high:g} is usual: another unit?"


def _told(column: RawColumn, values: FloatArray) -> str:
    """Return a comment of a column's name, unit and range."""
    known = values[np.isfinite(values)]
    span = f"{plain(known.min(), 6)} to {plain(known.max(), 6)}" if len(known) else "no number"
    return "# " + " ".join(filter(None, (toml(column.name), column.unit, span)))


def _candidates(
    raw: RawTable, cells: FloatArray, of_temperature: str = ""
) -> dict[str, list[SignalCandidate]]:
    """Return the columns that may carry each signal: by a name that is known, and by words.

    of_temperature : unit of the columns that state none
    """
    setting = dict.fromkeys(_TEMPERATURES, of_temperature)
    known: dict[str, tuple[str, Source]] = {}
    for profile in map(shipped_profile, shipped()):
        for name, sources in profile.signals.items():
            for source in sources:
                known.setdefault(key(source.column), (name, source))
    found: dict[str, list[SignalCandidate]] = {signal.name: [] for signal in SIGNALS}
    for i, column in enumerate(raw.columns):
        values, stated = cells[:, i], stated_unit(column, STOICH_AFR)
        if not column.name or not np.isfinite(values).any():
            continue
        for name, source in (known[each] for each in keys_of(column.name) if each in known):
            own = _known(name, source, column, values, stated or setting.get(name, ""))
            if own and (name not in WORDS["varying"] or np.nanmax(values) > np.nanmin(values)):
                is_plain = (source.factor, source.offset) == (1.0, 0.0)  # no gauge
                sure = QuantityFit(1.0 if is_plain else SURE, ("its name is known",))
                order = "AFR" in source.units, i  # lambda itself before what a gauge makes of it
                fitting = SignalCandidate(name, column.name, sure, _entry(own), order, True)
                found[name].append(fitting)
        for text in dict.fromkeys(_words(raw, each) for each in (column.name, *column.others)):
            for name in BY_NAME.keys() & QUANTITIES.keys():
                unit = stated or setting.get(name, "")
                if fit := fit_of(name, Description(text, unit, values=values)):
                    fit = fit.doubted("a profile knows no 1 / lambda") if fit.is_phi else fit
                    entry = _entry(_by_words(name, column, fit))
                    found[name].append(SignalCandidate(name, column.name, fit, entry, ()))
                elif stated and (fit := _of_other_unit(name, text, stated)):
                    found[name].append(SignalCandidate(name, column.name, fit, column.name, ()))
    return found


def _of_other_unit(name: str, text: str, stated: str) -> QuantityFit | None:
    """Return the doubted fit of a column that is a signal by its name alone, not by its unit."""
    sure, rest = match(QUANTITIES[name].phrases, words_of(text))
    doubt = f"its unit {stated} is of another quantity: which factor and offset?"
    is_said = sure >= SURE and not rest
    return QuantityFit(sure, (f"its name says {text}",)).doubted(doubt) if is_said else None


def _words(raw: RawTable, name: str) -> str:
    """Return a name without its unit and the number of its repeat; other text in brackets stays."""
    first, _, number = name.rpartition("#")
    name = first if number.isdigit() and first in raw.names else name
    bare, unit = name_and_unit(name)
    return bare if unit_of(unit, STOICH_AFR) or unit == "-" else name


def _known(
    name: str, source: Source, column: RawColumn, values: FloatArray, unit: str
) -> Source | None:
    """Return a column's source as a shipped profile knows it, None if it is of another quantity.

    unit : that the file states, or that the logger has for all such columns; "" if nothing tells it
    Where neither file nor profile states a unit, the values tell it.
    """
    is_other = not is_of_quantity(name, source, column, STOICH_AFR)
    if is_other or may_be_absolute(source, column, values):
        return None
    converts = source != Source(column=source.column, units=source.units, pinned=source.pinned)
    if name not in QUANTITIES or converts:
        low, high = plausible_range(name)
        is_told = converts or source.units or unit
        is_right = is_told or low <= np.nanmedian(values) <= high
        return replace(source, column=column.name) if is_right else None
    usual = () if QUANTITIES[name].unit.quantity in SEVERAL else source.units
    unit = unit or (usual[0] if len(usual) == 1 else "")
    fit = fit_of(name, Description(column.name, unit, values=values), is_named=True)
    if not fit or fit.doubt:
        return None
    return replace(_by_words(name, column, fit), pinned=source.pinned)


def _by_words(name: str, column: RawColumn, fit: QuantityFit) -> Source:
    """Return the source of a column as its fit reads it; what its file states needs no word."""
    stated = unit_of(stated_unit(column, STOICH_AFR), STOICH_AFR)
    if stated and stated.quantity == QUANTITIES[name].unit.quantity:
        return Source(column=column.name)
    if fit.unit:
        return Source(column=column.name, units=(fit.unit,))
    return Source(column=column.name, factor=fit.factor, offset=fit.offset)


def _time_columns(raw: RawTable, cells: FloatArray, signals: Collection[str]) -> list[str]:
    """Return the columns that tell the time: by name, as clocks, else the first that rises."""
    clocks = [each.name for each in raw.columns if each.name and each.kind == "clock"]
    named = [n for n in raw.names if match({"clock": 1.0}, words_of(name_and_unit(n)[0]))[0]]
    if not (named or clocks) and len(cells) > 1:
        steps = np.diff(cells, axis=0)
        units = [unit_of(stated_unit(column, STOICH_AFR), 1.0) for column in raw.columns]
        kinds = np.array([unit.quantity if unit else "" for unit in units])
        rises = ((steps >= 0.0).mean(axis=0) > _RISING) & (np.median(steps, axis=0) > 0.0)
        rises &= (steps == 1.0).mean(axis=0) < _RISING  # a counter of rows is no time
        rises &= [name not in signals for name in raw.names]
        rises &= kinds == ("time" if (rises & (kinds == "time")).any() else "")
        named = [raw.names[i] for i in np.flatnonzero(rises).tolist() if raw.names[i]][:1]
    if not (named or clocks):  # of seconds, beside hours or parts of them
        named = [n for n in raw.names if unit_of(n, 1.0) == UNITS["s"]]
    return list(dict.fromkeys((*named, *clocks)))


def _entry(source: Source) -> Entry:
    """Return a source as it stands in a file, as its column alone if that says all."""
    tree = source_tree(source) | ({"unit": source.units[0]} if len(source.units) == 1 else {})
    return tree if len(tree) > 1 else source.column
