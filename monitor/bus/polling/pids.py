"""The OBD-II parameters (PIDs) that carry the signals of a signal map.

They follow from the CAN database: its message 0x7E8 holds the engine's answers, and its signals are
multiplexed by ``Pid``. Every byte of a PID belongs to a signal, so the lengths follow, too.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from cantools.database.can import Message, Signal

from monitor.base.errors import SignalMapError
from monitor.decode.bus_map import BusChannel, BusMap
from monitor.decode.obd_answers import ANSWER
from monitor.decode.raw_values import last_byte

HEADER_BYTES: Final = 3  # of an answer in a single frame: length, service, PID
MULTIPLEXER: Final = "Pid"
MOST_PIDS: Final = 6  # per request, SAE J1979
BITMAPS: Final = (0x00, 0x20, 0x40, 0x60, 0x80, 0xA0, 0xC0)  # PIDs that tell which of the
BITMAP_BYTES: Final = 4  # next 32 PIDs are supported, SAE J1979
RANGE_TIMEOUT_S: Final = 600.0  # a range is a constant of the ECU; asked for first and seldom


@dataclass(frozen=True, slots=True)
class ObdParameter:
    """One request item, which carries one or several mapped signals."""

    pids: tuple[int, ...]  # alternatives; the first supported one is used
    names: tuple[str, ...]  # canonical names of the signals, none for ranges of other PIDs
    timeout_s: float  # shortest timeout of its signals


def wanted(bus_map: BusMap, names: Sequence[str]) -> tuple[ObdParameter, ...]:
    """Return the parameters that carry ``names``, in the map's order.

    names : canonical names of the map; signals of other messages are left out
    Raises SignalMapError if no signal can be polled.
    """
    channels = {name: bus_map.channels[name] for name in bus_map.sources(names)}
    groups: dict[tuple[int, ...], list[BusChannel]] = {}
    ranges = {
        pids: ObdParameter(pids, (), RANGE_TIMEOUT_S)
        for c in channels.values()
        if c.range is not None and (pids := _pids(c.message, c.range))
    }
    for channel in channels.values():
        pids = _pids(channel.message, channel.signal)
        if pids:
            groups.setdefault(pids, []).append(channel)
    if not groups:
        maps = ", ".join(str(map_path) for _, map_path in bus_map.pairs)
        raise SignalMapError(
            f"{maps}: nothing to ask for by OBD-II; signals multiplexed by {MULTIPLEXER} in the "
            f"message 0x{ANSWER:X} are wanted, as in obd2.dbc and obd2.toml"
        )
    signals = (
        ObdParameter(
            pids, tuple(c.mapped.name for c in group), min(c.mapped.timeout_s for c in group)
        )
        for pids, group in groups.items()
    )
    return (*ranges.values(), *signals)


def lengths(bus_map: BusMap, parameters: Iterable[ObdParameter]) -> Mapping[int, int]:
    """Return the number of data bytes of each PID, bitmaps included."""
    n_bytes = dict.fromkeys(BITMAPS, BITMAP_BYTES)
    asked = {pid for parameter in parameters for pid in parameter.pids}
    for message in {id(c.message): c.message for c in bus_map.channels.values()}.values():
        for signal in message.signals:
            for pid in asked.intersection(_pids(message, signal)):
                last = last_byte(message, signal) + 1 - HEADER_BYTES
                n_bytes[pid] = max(n_bytes.get(pid, 0), last)
    return n_bytes


def interval_s(parameters: Sequence[ObdParameter], rate_hz: float) -> float:
    """Return the approximate interval in s at which polling brings the fastest signals.

    rate_hz : requests per second, each with ``MOST_PIDS`` PIDs
    A PID is polled in inverse proportion to its timeout.
    """
    fastest_s = min(parameter.timeout_s for parameter in parameters)
    shares = sum(fastest_s / parameter.timeout_s for parameter in parameters)
    return shares / (MOST_PIDS * rate_hz)


def _pids(message: Message, signal: Signal) -> tuple[int, ...]:
    if (message.frame_id, message.is_extended_frame) != (ANSWER, False):
        return ()
    if signal.multiplexer_signal != MULTIPLEXER:
        return ()
    return tuple(sorted(signal.multiplexer_ids or ()))
