"""Signal maps tied to their CAN databases and merged into the signals of the bus.

Several pairs of DBC and map may be merged, an engine and a wideband controller for instance;
where two provide the same canonical signal, the later pair wins.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from logging import getLogger
from pathlib import Path
from textwrap import shorten
from typing import Final

from cantools.database import load_file, load_string
from cantools.database.can import Database, Message, Signal

from monitor.base.errors import SignalMapError
from monitor.base.files.inputs import read_small
from monitor.decode import soundness
from monitor.decode.dbc_text import read
from monitor.decode.parameter_groups import is_any_source
from monitor.decode.signal_map import Derived, Integrity, MappedSignal, SignalMap, load_signal_map

Pair = tuple[Path, Path]  # DBC, signal map
_LOGGER: Final = getLogger("cantools.database.can.database")
_LOGGER.addFilter(lambda record: "name to message" not in record.msg)  # see ``_told_apart``
_REASON: Final = 300  # characters of a parser's error: some quote a whole line


@dataclass(frozen=True, slots=True)
class BusChannel:
    """One signal on the bus: its place in the DBC and its meaning by the map."""

    mapped: MappedSignal
    message: Message
    signal: Signal
    integrity: Integrity
    dbc: Path
    map_path: Path
    range: Signal | None = None  # tells the highest value of the signal, 0 the database's
    any_source: bool = False  # its message is known by the parameter group, whoever sends it


@dataclass(frozen=True, slots=True)
class BusMap:
    """Everything that one or several pairs provide."""

    pairs: tuple[Pair, ...]
    channels: dict[str, BusChannel]  # by canonical or auxiliary name
    derived: dict[str, Derived]
    names: tuple[str, ...]  # what every vehicle sends, in the order of the maps
    optional: tuple[str, ...] = ()  # what can be asked for, but not every vehicle sends it
    catalyst_position: str = ""  # the last one that a map gives
    log_channel: str = ""  # of logs that hold several buses, the last one that a map gives
    notes: tuple[str, ...] = ()  # what of the databases was changed or left out to read them

    def sources(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return the channels needed for ``names``: those asked for, then what they derive from.

        Raises SignalMapError naming what no map provides.
        """
        missing = [name for name in names if name not in (*self.names, *self.optional)]
        if missing:
            files = ", ".join(str(map_path) for _, map_path in self.pairs)
            raise SignalMapError(f"{files}: does not provide {', '.join(missing)}")
        needed = [name for name in names if name not in self.derived]
        for name in names:
            if name in self.derived:
                needed.extend(self.derived[name].sources)
        return tuple(dict.fromkeys(needed))


def load_database(path: Path) -> Database:
    """Return the CAN database in ``path`` (.dbc, .arxml, .kcd, .sym).

    Raises SignalMapError if it cannot be read.
    """
    return read_database(path)[0]


def read_database(path: Path) -> tuple[Database, tuple[str, ...]]:
    """Return the CAN database in ``path``, and the changes and omissions that reading it took.

    Raises SignalMapError if it cannot be read.
    """
    notes: tuple[str, ...] = ()
    try:
        raw = read_small(path, soundness.MOST_BYTES)
        soundness.check_text(path, raw)
        try:
            database = load_file(path, strict=False)
        except Exception:  # cantools raises its parsers' own errors
            if path.suffix.lower() != ".dbc":
                raise
            text = raw.removeprefix(b"\xef\xbb\xbf").decode("cp1252", errors="replace")
            database, notes = read(text, lambda text: load_string(text, "dbc", strict=False))
    except OSError as error:
        raise SignalMapError(f"{path}: cannot read the CAN database: {error.strerror}") from error
    except SignalMapError:
        raise
    except Exception as error:
        reason = shorten(str(error) or type(error).__name__, _REASON, placeholder=" …")
        raise SignalMapError(f"{path}: not a CAN database: {reason}") from error
    if not isinstance(database, Database):
        raise SignalMapError(f"{path}: a diagnostics database, a CAN database is wanted")
    soundness.check_names(path, database)
    notes += _told_apart(database)
    if notes and not database.messages:
        raise SignalMapError(f"{path}: not a CAN database: no message can be read; {notes[0]}")
    return database, notes


def _told_apart(database: Database) -> tuple[str, ...]:
    """Put their identifiers behind a name that several messages have; return what was changed.

    A map names a message, and cantools finds only the last one of a name.
    """
    counts = Counter(message.name for message in database.messages)
    shared = [name for name, n in counts.items() if n > 1]
    if not shared:
        return ()
    for message in database.messages:
        if counts[message.name] > 1:
            message.name = f"{message.name}_{message.frame_id:X}"
    database.refresh()
    names = shorten(", ".join(shared), _REASON, placeholder=" …")
    return (f"several messages of one name, their identifiers now behind it: {names}",)


def load_pairs(pairs: Iterable[tuple[str | Path, str | Path]], channel: str = "") -> BusMap:
    """Return the signals that the pairs of DBC and signal map provide together.

    channel : of logs that hold several buses, before that of a map
    Raises SignalMapError naming map, DBC and signal where they do not fit each other.
    """
    paths: tuple[Pair, ...] = tuple((Path(dbc), Path(map_path)) for dbc, map_path in pairs)
    if not paths:
        raise SignalMapError("no pair of DBC and signal map is given")
    channels: dict[str, BusChannel] = {}
    derived: dict[str, Derived] = {}
    names: dict[str, None] = {}
    optional: dict[str, None] = {}
    auxiliary: dict[str, Path] = {}
    notes: list[str] = []
    position = log_channel = ""
    for dbc, map_path in paths:
        signal_map = load_signal_map(map_path)
        position = signal_map.catalyst_position or position
        log_channel = signal_map.log_channel or log_channel
        database, changed = read_database(dbc)
        notes.extend(f"{dbc}: {note}" for note in changed)
        for name in signal_map.auxiliary:
            if name in auxiliary or name in names:
                raise SignalMapError(f"{map_path}: {name} is also defined by {auxiliary.get(name)}")
            auxiliary[name] = map_path
        both = [*signal_map.signals.values(), *signal_map.optional.values()]
        for mapped in [*both, *signal_map.auxiliary.values()]:
            derived.pop(mapped.name, None)
            channels[mapped.name] = _channel(mapped, signal_map, database, dbc)
        for name, each in signal_map.derived.items():
            channels.pop(name, None)
            derived[name] = each
        names.update(dict.fromkeys([*signal_map.signals, *signal_map.derived]))
        optional.update(dict.fromkeys(signal_map.optional))
    _check_overlap(channels)
    _check_derived(channels, derived, paths)
    return BusMap(
        pairs=paths,
        channels=channels,
        derived=derived,
        names=tuple(names),
        optional=tuple(name for name in optional if name not in names),
        catalyst_position=position,
        log_channel=channel or log_channel,
        notes=tuple(notes),
    )


def _channel(
    mapped: MappedSignal, signal_map: SignalMap, database: Database, dbc: Path
) -> BusChannel:
    """Return ``mapped`` tied to the database, or raise SignalMapError."""
    where = f"{signal_map.path}: {mapped.name} wants"
    try:
        message = database.get_message_by_name(mapped.message)
    except KeyError:
        like = _alike(mapped.message, [message.name for message in database.messages])
        place = f"message {mapped.message}, which {dbc} lacks"
        raise SignalMapError(f"{where} {place}{like}") from None
    soundness.check_message(dbc, message)
    integrity = signal_map.integrity_of(mapped.message)
    present = [signal.name for signal in message.signals]
    for wanted in (mapped.signal, mapped.range, integrity.counter, integrity.checksum):
        if wanted and wanted not in present:
            like = _alike(wanted, present)
            place = f"signal {mapped.message}.{wanted}, which {dbc} lacks"
            raise SignalMapError(f"{where} {place}{like}")
        if wanted:
            soundness.check_signal(dbc, message, wanted)
    signal = message.get_signal_by_name(mapped.signal)
    if mapped.range and not signal.maximum:
        raise SignalMapError(f"{where} range, and {mapped.signal} of {dbc} has no highest value")
    return BusChannel(
        mapped=mapped,
        message=message,
        signal=signal,
        range=message.get_signal_by_name(mapped.range) if mapped.range else None,
        integrity=integrity,
        dbc=dbc,
        map_path=signal_map.path,
        any_source=is_any_source(message, database),
    )


def _alike(wanted: str, present: Sequence[str]) -> str:
    """Return which names are nearest to one that is not there, in words; "" if none is near."""
    by_small = {name.lower(): name for name in present}
    near = get_close_matches(wanted.lower(), by_small, n=3, cutoff=0.5)
    return f"; did you mean {' or '.join(by_small[name] for name in near)}?" if near else ""


def _check_overlap(channels: dict[str, BusChannel]) -> None:
    """Raise SignalMapError if one identifier stands for different messages."""
    owners: dict[tuple[int, bool], BusChannel] = {}
    for channel in channels.values():
        message = channel.message
        owner = owners.setdefault((message.frame_id, message.is_extended_frame), channel)
        own = (message.name, channel.dbc, channel.integrity)
        if own != (owner.message.name, owner.dbc, owner.integrity):
            raise SignalMapError(
                f"{channel.map_path}: message {message.name} has identifier "
                f"0x{message.frame_id:X}, as {owner.message.name} of {owner.dbc} has"
            )


def _check_derived(
    channels: dict[str, BusChannel], derived: dict[str, Derived], pairs: tuple[Pair, ...]
) -> None:
    """Raise SignalMapError if a merged map took away a source of a derived signal."""
    for each in derived.values():
        for source in each.sources:
            if source not in channels:
                raise SignalMapError(
                    f"{pairs[-1][1]}: {each.name} is derived from {source}, which is itself derived"
                )
