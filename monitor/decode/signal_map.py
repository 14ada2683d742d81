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
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from monitor.base.config import POSITIONS
from monitor.base.errors import SignalMapError
from monitor.base.files.toml_table import TomlTable
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
    raw = TomlTable.of_file(path, "the signal map", SignalMapError).only(_SECTIONS)
    integrity = _integrity(raw.table("integrity"), Integrity())
    of_messages = raw.table("messages")
    messages = {name: _integrity(of_messages.table(name), integrity) for name in of_messages}
    signals, auxiliary, optional = (
        {name: _signal(table, name) for name in _names(table)}
        for table in map(raw.table, ("signals", "auxiliary", "optional"))
    )
    mapped = {**signals, **auxiliary}
    derived = {
        name: _derived(table.table(name), name, mapped)
        for table in [raw.table("derived")]
        for name in _names(table)
    }
    if not signals and not derived:
        raise raw.fault("[signals] is empty, at least one is needed")
    twice = signals.keys() & auxiliary.keys() | mapped.keys() & derived.keys()
    for name in twice | optional.keys() & (mapped.keys() | derived.keys()):
        raise raw.fault(f"{name} is defined twice")
    position = raw.table("catalyst").only({"position"})
    return SignalMap(
        path=path,
        signals=signals,
        optional={name: replace(each, is_optional=True) for name, each in optional.items()},
        auxiliary=auxiliary,
        derived=derived,
        integrity=integrity,
        messages=messages,
        catalyst_position=_one_of(position, "position", ("", *POSITIONS), ""),
        log_channel=raw.table("log").only({"channel"}).value("channel", str, ""),
    )


def _one_of(table: TomlTable, key: str, known: Collection[str], default: str) -> str:
    value: str = table.value(key, str, default)
    if value not in known:
        raise table.fault(f"{key} is {value!r}, known are {', '.join(filter(None, known))}")
    return value


def _integrity(table: TomlTable, base: Integrity) -> Integrity:
    _one_of(table, "algorithm", ALGORITHMS, base.algorithm)
    _one_of(table, "not_available", ("", "all_ones"), base.not_available)
    return table.record(base)


def _names(table: TomlTable) -> Iterator[str]:
    for name in table:
        if not _NAME.match(name):
            raise table.fault(f"{name!r} is no name: letters, digits and _ are wanted")
        yield name


def _signal(section: TomlTable, name: str) -> MappedSignal:
    table = section.table(name)
    table.only({"message", "signal", "factor", "offset", "timeout_s", "range"})
    timeout_s = table.value("timeout_s", float, DEFAULT_TIMEOUT_S)
    factor = table.value("factor", float, 1.0)
    if not 0.0 < timeout_s <= LONGEST_TIMEOUT_S or factor == 0.0:
        raise table.fault(
            f"wants timeout_s above 0 and at most {LONGEST_TIMEOUT_S:g}, and a factor other than 0"
        )
    return MappedSignal(
        name=name,
        message=table.value("message", str),
        signal=table.value("signal", str),
        factor=factor,
        offset=table.value("offset", float, 0.0),
        timeout_s=timeout_s,
        range=table.value("range", str, ""),
    )


def _derived(table: TomlTable, name: str, mapped: Mapping[str, MappedSignal]) -> Derived:
    table.only({"factor", "numerator", "denominator"})
    numerator, denominator = table.values("numerator", str), table.values("denominator", str)
    for source in numerator + denominator:
        if source not in mapped:
            raise table.fault(f"uses {source!r}, which is in neither [signals] nor [auxiliary]")
    if not numerator + denominator:
        raise table.fault("names no signal to derive from")
    return Derived(name, table.value("factor", float, 1.0), numerator, denominator)
