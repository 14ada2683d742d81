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

Names are compared without case, spaces and punctuation. The unit that a file states counts;
``unit`` is for files that state none, a list of them for loggers whose unit is a setting: the first
with which most columns are plausible is taken, for all alike.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from monitor.base.errors import ConfigError
from monitor.base.files.inputs import read_toml
from monitor.base.signals import BY_NAME

STOICH_AFR: Final = 14.7
_KEYS: Final = {"title", "based_on", "stoich_afr", "time", "recognise", "signals", "engine"}
_SOURCE_NAMES: Final = {"units": "unit", "inverted": "not"}  # fields whose keys differ
_SOURCE_FIELDS: Final = {key: name for name, key in _SOURCE_NAMES.items()}


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
    return _ProfileReader(path).profile(tree)


def tree_of(profile: Profile) -> dict[str, Any]:
    """Return the tree from which ``profile_of`` makes the profile again, without based_on."""
    return {
        "title": profile.title,
        "stoich_afr": profile.stoich_afr,
        "time": [_source_tree(source) for source in profile.time],
        "signals": {
            name: [_source_tree(source) for source in sources]
            for name, sources in profile.signals.items()
        },
        "engine": {each.name: getattr(profile.engine, each.name) for each in fields(ProfileEngine)},
    }


def _source_tree(source: Source) -> dict[str, Any]:
    plain = Source(column=source.column)
    changed = {
        _SOURCE_NAMES.get(each.name, each.name): getattr(source, each.name)
        for each in fields(Source)
        if getattr(source, each.name) != getattr(plain, each.name)
    }
    lists = {key: list(value) for key, value in changed.items() if isinstance(value, tuple)}
    return {"column": source.column} | changed | lists


class _ProfileReader:
    """Checks every key of a profile."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def profile(self, raw: Mapping[str, Any]) -> Profile:
        self._keys("the profile", raw, _KEYS)
        based_on = raw.get("based_on")
        base = (
            Profile(name="", title="")
            if based_on is None
            else shipped_profile(self._text("based_on", based_on))
        )
        signals = dict(base.signals)
        for name, given in self._table("signals", raw.get("signals", {})).items():
            if name not in BY_NAME:
                raise self._error(f"[signals] {name}", "is no canonical signal")
            signals[name] = self._sources(f"[signals] {name}", given)
        recognise = tuple(self._recognition(each) for each in raw.get("recognise", []))
        time = self._sources("time", raw["time"]) if "time" in raw else base.time
        return Profile(
            name=self._path.stem,
            title=self._text("title", raw.get("title", base.title or self._path.stem)),
            stoich_afr=self._number("stoich_afr", raw.get("stoich_afr", base.stoich_afr)),
            time=time,
            recognise=recognise or base.recognise,
            signals=signals,
            engine=self._engine(self._table("engine", raw.get("engine", {})), base.engine),
        )

    def _error(self, key: str, problem: str) -> ConfigError:
        return ConfigError(f"{self._path}: {key}: {problem}")

    def _keys(self, key: str, given: Mapping[str, Any], known: Collection[str]) -> None:
        unknown = sorted(given.keys() - set(known))
        if unknown:
            wanted = ", ".join(sorted(known))
            raise self._error(key, f"has the unknown key {unknown[0]!r}, known are {wanted}")

    def _table(self, key: str, given: Any) -> dict[str, Any]:
        if not isinstance(given, dict):
            raise self._error(key, f"is {given!r}, a table is wanted")
        return given

    def _text(self, key: str, given: Any) -> str:
        if not isinstance(given, str) or not given:
            raise self._error(key, f"is {given!r}, a text is wanted")
        return given

    def _number(self, key: str, given: Any) -> float:
        if isinstance(given, bool) or not isinstance(given, int | float):
            raise self._error(key, f"is {given!r}, a number is wanted")
        return float(given)

    def _texts(self, key: str, given: Any) -> tuple[str, ...]:
        return tuple(self._text(key, each) for each in _listed(given))

    def _recognition(self, given: Any) -> Recognition:
        table = self._table("[[recognise]]", given)
        self._keys("[[recognise]]", table, {"columns", "preamble"})
        return Recognition(
            self._texts("[[recognise]] columns", table.get("columns", [])),
            self._texts("[[recognise]] preamble", table.get("preamble", [])),
        )

    def _sources(self, key: str, given: Any) -> tuple[Source, ...]:
        return tuple(self._source(key, each) for each in _listed(given))

    def _source(self, key: str, given: Any) -> Source:
        kinds: dict[str, Callable[[str, Any], Any]] = {
            "column": self._text,
            "unit": self._texts,
            "bit": self._bit,
            "words": self._texts,
            "not": lambda _, value: bool(value),
            **dict.fromkeys(("factor", "offset", "above"), self._number),
            **dict.fromkeys(("equals", "pinned"), self._numbers),
        }
        table = {"column": given} if isinstance(given, str) else self._table(key, given)
        self._keys(key, table, kinds.keys())
        values = {k: kinds[k](f"{key} {k}", v) for k, v in ({"column": None} | table).items()}
        return Source(**{_SOURCE_FIELDS.get(k, k): value for k, value in values.items()})

    def _bit(self, key: str, given: Any) -> int:
        if isinstance(given, bool) or not isinstance(given, int) or given < 0:
            raise self._error(key, f"is {given!r}, a whole number from 0 is wanted")
        return given

    def _numbers(self, key: str, given: Any) -> tuple[float, ...]:
        return tuple(self._number(key, each) for each in _listed(given))

    def _engine(self, given: Mapping[str, Any], base: ProfileEngine) -> ProfileEngine:
        self._keys("[engine]", given, {each.name for each in fields(ProfileEngine)})
        values = {name: self._number(f"[engine] {name}", value) for name, value in given.items()}
        for name in ("cylinders", "injector_mg_per_ms"):
            if not values.get(name, 1.0) > 0.0:
                raise self._error(f"[engine] {name}", f"is {values[name]:g}, above 0 is wanted")
        cylinders = int(values.pop("cylinders", base.cylinders))
        return replace(base, cylinders=cylinders, **values)


def _listed(given: Any) -> Sequence[Any]:
    return given if isinstance(given, list) else [given]
