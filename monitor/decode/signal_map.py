"""Signal maps: which CAN signal carries which canonical signal.

A map is a TOML file beside a DBC::

    [integrity]                      # for every mapped message; each key is optional
    counter = "AliveCounter"         # signal that counts up by 1, wrapping round
    checksum = "Checksum"            # 8-bit signal that fills one byte
    algorithm = "crc8_sae_j1850_id"  # or crc8_sae_j1850, without the identifier
    not_available = "all_ones"       # raw value of unsigned signals of 2 bits and more that say
                                     # nothing; signed ones say it with their lowest value
    [messages.NAME]                  # the same keys for one message; "" switches a check off
    [signals]                        # canonical = factor * signal + offset
    lambda_measured = { message = "M", signal = "S", factor = 1.0, offset = 0.0, timeout_s = 0.3 }
                                     # range = "R": a signal of the same message that tells the
                                     # highest value of S; 0, or none yet, leaves the database's
    [optional]                       # as [signals], of a sensor that not every vehicle has: silence
                                     # of a message with such signals alone is no fault
    [catalyst]
    position = "close_coupled"       # the sensor stands behind a warm-up catalyst close to the
                                     # engine, before another one; by default "underfloor"
    [log]
    channel = "can0"                 # of logs that hold several buses: the one that is meant
    [auxiliary]                      # as [signals], only for use in derived signals
    [derived.fuel_mass_mg]           # factor * product of numerator / product of denominator
    factor = 30000.0
    numerator = ["fuel_flow_g_s"]
    denominator = ["engine_speed_rpm"]
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from monitor.base.config import POSITIONS
from monitor.base.errors import SignalMapError
from monitor.base.files.inputs import as_number, in_words, read_toml
from monitor.decode.checksum import ALGORITHMS

DEFAULT_TIMEOUT_S: Final = 0.5
LONGEST_TIMEOUT_S: Final = 1e6  # eleven days
_SECTIONS: Final = {
    "integrity",
    "messages",
    "signals",
    "optional",
    "catalyst",
    "log",
    "auxiliary",
    "derived",
}
_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")


@dataclass(frozen=True, slots=True)
class MappedSignal:
    """Where one signal comes from: value = factor * DBC value + offset."""

    name: str
    message: str
    signal: str
    factor: float = 1.0
    offset: float = 0.0
    timeout_s: float = DEFAULT_TIMEOUT_S  # a value older than this is stale
    is_optional: bool = False  # not every vehicle sends it
    range: str = ""  # signal of the same message that tells the highest value of this one


@dataclass(frozen=True, slots=True)
class Integrity:
    """How one message is protected; an empty name means that it is not."""

    counter: str = ""
    checksum: str = ""
    algorithm: str = "crc8_sae_j1850_id"
    not_available: str = ""  # "all_ones" or ""


@dataclass(frozen=True, slots=True)
class Derived:
    """A signal made from others: factor * product(numerator) / product(denominator)."""

    name: str
    factor: float
    numerator: tuple[str, ...]
    denominator: tuple[str, ...]

    @property
    def sources(self) -> tuple[str, ...]:
        """Return the names it is made from."""
        return self.numerator + self.denominator


@dataclass(frozen=True, slots=True)
class SignalMap:
    """One parsed map file, not yet tied to a DBC."""

    path: Path
    signals: Mapping[str, MappedSignal]
    optional: Mapping[str, MappedSignal] = field(default_factory=dict)
    auxiliary: Mapping[str, MappedSignal] = field(default_factory=dict)
    derived: Mapping[str, Derived] = field(default_factory=dict)
    integrity: Integrity = field(default_factory=Integrity)
    messages: Mapping[str, Integrity] = field(default_factory=dict)
    catalyst_position: str = ""  # of the judged catalyst; "" leaves it to the configuration
    log_channel: str = ""  # of logs that hold several buses

    def integrity_of(self, message: str) -> Integrity:
        """Return how ``message`` is protected."""
        return self.messages.get(message, self.integrity)


def load_signal_map(path: Path) -> SignalMap:
    """Return the map in the TOML file ``path``.

    Raises SignalMapError naming the file and the key if it cannot be read, has an unknown key
    or an impossible value.
    """
    return _MapReader(path).signal_map(read_toml(path, "the signal map", SignalMapError))


class _MapReader:
    """Checks and converts the parsed TOML of one file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def signal_map(self, raw: Mapping[str, Any]) -> SignalMap:
        self._known(raw, "", _SECTIONS)
        integrity = self._integrity(self._table(raw, "integrity"), "integrity", Integrity())
        messages = {
            name: self._integrity(self._table(each, name), f"messages.{name}", integrity)
            for each in [self._table(raw, "messages")]
            for name in each
        }
        signals = self._signals(self._table(raw, "signals"), "signals")
        auxiliary = self._signals(self._table(raw, "auxiliary"), "auxiliary")
        optional = {
            name: replace(each, is_optional=True)
            for name, each in self._signals(self._table(raw, "optional"), "optional").items()
        }
        mapped = {**signals, **auxiliary}
        derived = self._derived(self._table(raw, "derived"), mapped)
        if not signals and not derived:
            raise SignalMapError(f"{self.path}: [signals] is empty, at least one is needed")
        twice = signals.keys() & auxiliary.keys() | mapped.keys() & derived.keys()
        for name in twice | optional.keys() & (mapped.keys() | derived.keys()):
            raise SignalMapError(f"{self.path}: {name} is defined twice")
        return SignalMap(
            path=self.path,
            signals=signals,
            optional=optional,
            auxiliary=auxiliary,
            derived=derived,
            integrity=integrity,
            messages=messages,
            catalyst_position=self._position(self._table(raw, "catalyst")),
            log_channel=self._log_channel(self._table(raw, "log")),
        )

    def _log_channel(self, table: Mapping[str, Any]) -> str:
        self._known(table, "log", {"channel"})
        return self._text(table, "channel", "log") if table else ""

    def _position(self, table: Mapping[str, Any]) -> str:
        self._known(table, "catalyst", {"position"})
        position = self._text(table, "position", "catalyst") if table else ""
        if position not in ("", *POSITIONS):
            raise SignalMapError(
                f"{self.path}: [catalyst] position is {position!r}, "
                f"wanted one of {', '.join(POSITIONS)}"
            )
        return position

    def _known(self, table: Mapping[str, Any], where: str, keys: set[str]) -> None:
        unknown = sorted(table.keys() - keys)
        if unknown:
            place = f"[{where}] " if where else ""
            wanted = ", ".join(sorted(keys))
            raise SignalMapError(
                f"{self.path}: {place}has the unknown key {unknown[0]!r}, known are {wanted}"
            )

    def _table(self, raw: Mapping[str, Any], key: str) -> Mapping[str, Any]:
        table = raw.get(key, {})
        if not isinstance(table, dict):
            raise SignalMapError(f"{self.path}: {key} is {table!r}, a table is wanted")
        return table

    def _integrity(self, table: Mapping[str, Any], where: str, base: Integrity) -> Integrity:
        self._known(table, where, {"counter", "checksum", "algorithm", "not_available"})
        for key in table:
            self._text(table, key, where)
        result = replace(base, **table)
        if result.algorithm not in ALGORITHMS:
            raise SignalMapError(
                f"{self.path}: [{where}] algorithm is {result.algorithm!r}, "
                f"known are {', '.join(ALGORITHMS)}"
            )
        if result.not_available not in {"", "all_ones"}:
            raise SignalMapError(
                f"{self.path}: [{where}] not_available is {result.not_available!r}, "
                'it may be "all_ones" or ""'
            )
        return result

    def _signals(self, table: Mapping[str, Any], where: str) -> dict[str, MappedSignal]:
        result = {}
        for name in table:
            place = f"{where}.{name}"
            self._check_name(name, where)
            entry = self._table(table, name)
            keys = {"message", "signal", "factor", "offset", "timeout_s", "range"}
            self._known(entry, place, keys)
            timeout_s = self._number(entry, "timeout_s", place, DEFAULT_TIMEOUT_S)
            factor = self._number(entry, "factor", place, 1.0)
            if not 0.0 < timeout_s <= LONGEST_TIMEOUT_S or factor == 0.0:
                raise SignalMapError(
                    f"{self.path}: [{place}] wants timeout_s above 0 and at most "
                    f"{LONGEST_TIMEOUT_S:g}, and a factor other than 0"
                )
            result[name] = MappedSignal(
                name=name,
                message=self._text(entry, "message", place),
                signal=self._text(entry, "signal", place),
                factor=factor,
                offset=self._number(entry, "offset", place, 0.0),
                timeout_s=timeout_s,
                range=self._text(entry, "range", place) if "range" in entry else "",
            )
        return result

    def _derived(
        self, table: Mapping[str, Any], mapped: Mapping[str, MappedSignal]
    ) -> dict[str, Derived]:
        result = {}
        for name in table:
            place = f"derived.{name}"
            self._check_name(name, "derived")
            entry = self._table(table, name)
            self._known(entry, place, {"factor", "numerator", "denominator"})
            lists = [self._names(entry, key, place) for key in ("numerator", "denominator")]
            for source in [s for each in lists for s in each]:
                if source not in mapped:
                    raise SignalMapError(
                        f"{self.path}: [{place}] uses {source!r}, which is in neither "
                        "[signals] nor [auxiliary]"
                    )
            if not any(lists):
                raise SignalMapError(f"{self.path}: [{place}] names no signal to derive from")
            factor = self._number(entry, "factor", place, 1.0)
            result[name] = Derived(name, factor, tuple(lists[0]), tuple(lists[1]))
        return result

    def _names(self, table: Mapping[str, Any], key: str, where: str) -> list[str]:
        value = table.get(key, [])
        if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
            raise SignalMapError(f"{self.path}: [{where}] {key} is {value!r}, names are wanted")
        return value

    def _check_name(self, name: str, where: str) -> None:
        if not _NAME.match(name):
            raise SignalMapError(
                f"{self.path}: [{where}] {name!r} is no name: letters, digits and _ are wanted"
            )

    def _text(self, table: Mapping[str, Any], key: str, where: str) -> str:
        value = table.get(key)
        if not isinstance(value, str):
            came = "missing" if value is None else repr(value)
            raise SignalMapError(f"{self.path}: [{where}] {key} is {came}, a text is wanted")
        return value

    def _number(self, table: Mapping[str, Any], key: str, where: str, default: float) -> float:
        value = table.get(key, default)
        number = as_number(value)
        if number is None:
            raise SignalMapError(
                f"{self.path}: [{where}] {key} is {in_words(value)}, a number is wanted"
            )
        return number
