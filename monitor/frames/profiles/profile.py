"""A profile: the columns of one logger, their units, and values that say "no sensor".

::

    title = "COBB Accessport"
    stoich_afr = 14.7                                  # of the fuel; default 14.7
    time = ["Time (sec)"]
    [[recognise]]                                      # one of these must fit
    columns = ["AP Info", "RPM", "Calculated Load"]    # all there
    [signals]                                          # canonical name = columns, the best first
    engine_speed_rpm = "RPM"
    lambda_measured = [{ column = "A/F Sens 1 Ratio", unit = "AFR", pinned = [29.4] }]
    [engine]                                           # to derive air and fuel per stroke
    cylinders = 4
    [pivot]                                            # columns of a table with one value a row
    name = "Channel"
    value = "Reading"
    unit = "Unit"                                      # may be missing

Names are compared without case, spaces and punctuation. The unit that a file states counts;
``unit`` is for files that state none, a list of them for loggers whose unit is a setting: the first
with which most columns are plausible is taken, for all alike.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from monitor.base.errors import ConfigError
from monitor.base.files.inputs import read_toml
from monitor.base.files.toml_table import TomlTable
from monitor.base.signals import BY_NAME
from monitor.frames.tables.raw_table import Pivot

STOICH_AFR: Final = 14.7
_SOURCE_NAMES: Final = {"units": "unit", "inverted": "not"}  # fields whose keys differ


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """One column that may carry a signal: signal = factor * value in the signal's unit + offset."""

    column: str
    units: tuple[str, ...] = ()  # where the file states none
    factor: float = 1.0
    offset: float = 0.0
    bit: int | None = None  # 1 if the bit is set
    equals: tuple[float, ...] = ()  # 1 for these values
    above: float | None = None  # 1 for values above it
    words: tuple[str, ...] = ()  # 1 for cells of text with one of these
    inverted: bool = False  # 0 for 1
    pinned: tuple[float, ...] = ()  # values in the column's unit that say "no sensor"

    @property
    def is_flag(self) -> bool:
        """Return whether the column's values are tested, and not converted."""
        return bool(self.bit is not None or self.equals or self.above is not None or self.words)


@dataclass(frozen=True, slots=True)
class ProfileEngine:
    """Data of the engine, for signals that no column has; the model's gain absorbs their error."""

    cylinders: int = 4
    injector_mg_per_ms: float = 3.0  # 240 cm³/min of petrol at its rated pressure
    injector_dead_time_ms: float = 1.0  # at 14 V
    injector_dead_time_ms_per_v: float = 0.1  # more for each V below 14 V
    overrun_below_kpa: float = 0.0  # fuel cut below this pressure ...
    overrun_above_rpm: float = 1500.0  # ... and above this speed; where no column tells


@dataclass(frozen=True, slots=True)
class Recognition:
    """One way to know the logger: all of these hold."""

    columns: tuple[str, ...] = ()
    preamble: tuple[str, ...] = ()  # all in the text before the columns


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """How the files of one logger are read."""

    name: str
    title: str
    stoich_afr: float = STOICH_AFR
    time: tuple[Source, ...] = ()
    recognise: tuple[Recognition, ...] = ()
    signals: Mapping[str, tuple[Source, ...]] = field(default_factory=dict)
    engine: ProfileEngine = field(default_factory=ProfileEngine)
    pivot: Pivot | None = None
    file: Path | None = field(default=None, compare=False)


def shipped() -> tuple[str, ...]:
    """Return the names of the profiles that come with the package."""
    return tuple(sorted(path.name.removesuffix(".toml") for path in _shipped_folder().iterdir()))


def _shipped_folder() -> Path:
    return Path(str(files(__package__))) / "loggers"


@cache
def shipped_profile(name: str) -> Profile:
    """Return a profile that comes with the package; raises ConfigError for an unknown name."""
    return load_profile(path_of(name))


def path_of(given: str | Path) -> Path:
    """Return the file of a profile or columns map: of a shipped profile by its name, or a file.

    Raises ConfigError if it is neither.
    """
    path = Path(given)
    if str(given) in shipped() and not path.is_file():
        return _shipped_folder() / f"{given}.toml"
    if not path.suffix and not path.exists():
        raise ConfigError(f"no profile {given}: a file or one of {', '.join(shipped())} is wanted")
    return path


def is_profile(path: Path) -> bool:
    """Return whether a TOML file is a profile: no columns map, and no map of a bus's messages."""
    try:
        raw = read_toml(path, "the columns map", ConfigError)
    except ConfigError:
        return False
    signals = raw.get("signals")
    if not isinstance(signals, dict):
        return "based_on" in raw
    return not any(isinstance(each, dict) and "message" in each for each in signals.values())


def load_profile(path: Path) -> Profile:
    """Return the profile in a TOML file.

    Raises ConfigError with file, key, what came and what was wanted.
    """
    tree = read_toml(path, "the profile", ConfigError)
    return replace(profile_of(tree, path), file=path)


def profile_of(tree: Mapping[str, Any], path: Path) -> Profile:
    """Return the profile of a TOML file's tree; raises ConfigError as ``load_profile``."""
    keys = {"based_on", *(each.name for each in fields(Profile))} - {"name", "file"}
    table = TomlTable(tree, path, ConfigError).only(keys)
    base, signals = Profile(name="", title=""), table.table("signals")
    if "based_on" in table:
        base = shipped_profile(table.value("based_on", str))
    for name in signals:
        if name not in BY_NAME:
            raise signals.fault(f"{name} is no canonical signal")
    return Profile(
        name=path.stem,
        title=table.value("title", str, base.title) or path.stem,
        stoich_afr=table.value("stoich_afr", float, base.stoich_afr),
        time=_sources(table, "time") if "time" in table else base.time,
        recognise=tuple(map(_recognition, table.tables("recognise"))) or base.recognise,
        signals={**base.signals, **{name: _sources(signals, name) for name in signals}},
        engine=_engine(table.table("engine"), base.engine),
        pivot=_pivot(table.table("pivot")) if "pivot" in table else base.pivot,
    )


def source_tree(source: Source) -> dict[str, Any]:
    """Return the tree of a source: its column, and what differs from the defaults."""
    plain = Source(column=source.column)
    changed = {
        _SOURCE_NAMES.get(each.name, each.name): getattr(source, each.name)
        for each in fields(Source)
        if getattr(source, each.name) != getattr(plain, each.name)
    }
    lists = {key: list(value) for key, value in changed.items() if isinstance(value, tuple)}
    return {"column": source.column} | changed | lists


def _recognition(table: TomlTable) -> Recognition:
    found = table.record(Recognition())
    if "" in found.columns + found.preamble:
        raise table.fault("names an empty text")
    return found


def _sources(table: TomlTable, key: str) -> tuple[Source, ...]:
    given = table.tree[key]
    every = given if isinstance(given, list) else [given]
    return tuple(_source(table, key, each) for each in every)


def _source(of: TomlTable, key: str, given: Any) -> Source:
    tree = {"column": given} if isinstance(given, str) else given
    table = TomlTable({key: tree}, of.path, ConfigError, of.where).table(key)
    source = table.record(Source(column=""), _SOURCE_NAMES)
    if not source.column:
        raise table.fault("column is '', a text is wanted")
    if (source.bit or 0) < 0:
        raise table.unwanted("bit", "a whole number from 0 is")
    return source


def _pivot(table: TomlTable) -> Pivot:
    table.only(Pivot._fields)
    name, value = (table.value(key, str) for key in ("name", "value"))
    if not (name and value):
        raise table.fault("names no column of names and no column of values")
    return Pivot(name, value, table.value("unit", str, ""))


def _engine(table: TomlTable, base: ProfileEngine) -> ProfileEngine:
    engine = table.record(base)
    for name in ("cylinders", "injector_mg_per_ms"):
        if not getattr(engine, name) > 0:
            raise table.unwanted(name, "above 0 is")
    return engine
