"""The OBD-II parameters (PIDs) that carry the signals of a signal map.

They follow from the CAN database: its message 0x7E8 holds the engine's answers, and its signals are
multiplexed by ``Pid``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from cantools.database.can import Message, Signal

from monitor.base.errors import SignalMapError
from monitor.decode.bus_map import BusChannel, BusMap
from monitor.decode.obd_answers import ANSWER

MULTIPLEXER: Final = "Pid"
MOST_PIDS: Final = 6  # per request, SAE J1979
# PIDs that tell which of the next 32 PIDs are supported, SAE J1979
BITMAPS: Final = (0x00, 0x20, 0x40, 0x60, 0x80, 0xA0, 0xC0)
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


def _pids(message: Message, signal: Signal) -> tuple[int, ...]:
    if (message.frame_id, message.is_extended_frame) != (ANSWER, False):
        return ()
    if signal.multiplexer_signal != MULTIPLEXER:
        return ()
    return tuple(sorted(signal.multiplexer_ids or ()))
