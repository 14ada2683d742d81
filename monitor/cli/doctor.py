"""``o2mon doctor``: say what is wrong with a bus, and what to do about it."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from monitor.base.counts import counted
from monitor.base.errors import UsageError
from monitor.cli.check import heard
from monitor.cli.options import (
    NOT_JUDGED,
    Bus,
    Seconds,
    SetupOptions,
    bus_address,
    say,
    set_up,
)

if TYPE_CHECKING:
    from monitor.bus.bench.findings import BusFinding
    from monitor.bus.bench.interface import Interface

EXAMPLES = """examples:
  o2mon doctor -i socketcan -c can0
  o2mon doctor -i socketcan -c can0 --dbc engine.dbc --map engine.toml --seconds 10
  sudo o2mon doctor -i socketcan -c can0 --scan          which bit rate?

exit code: 0 nothing wrong was found, 3 something was, 2 the bus cannot be used"""
SCAN_S = 1.0  # at each bit rate
NO_SCAN = "--scan needs a SocketCAN interface with a bit rate; elsewhere its driver's tool sets it"


@dataclass(frozen=True, kw_only=True)
class DoctorOptions(SetupOptions):
    """Options of a diagnosis.

    seconds : time to listen, in s
    scan : try the usual bit rates, listen-only, as root, then restore the interface; other programs
        that use it hear nothing meanwhile
    """

    bus: Bus
    seconds: Seconds = 5.0
    scan: bool = False


def run(args: DoctorOptions) -> int:
    """Listen to a bus and say what is wrong with it, a sentence each, and what to do.

    It sends nothing. What is asked: bit rate and error counters of the interface, error frames,
    missing acknowledgement, the messages of the map with their rates, two senders of one message,
    the values of the signals.
    """
    from monitor.bus.bench.findings import of_interface

    interface = _interface(args)
    found = [*_scan(args, interface)] if args.scan else []
    if interface:
        found = found or [*of_interface(interface)]
    found = found or [*_listened(args, interface)]
    for number, each in enumerate(found, 1):
        say("\n   -> ".join([f"{number}. {each.lines[0]}", each.lines[1]]))
    if not found:
        say("nothing wrong was found")
    return NOT_JUDGED if found else 0


def _interface(args: DoctorOptions) -> "Interface | None":
    """Return the interface if it is one of SocketCAN, and say what it tells of itself."""
    from monitor.bus.bench.interface import Interface

    name, channel = bus_address(args.bus)
    if not name or (name == "socketcan" and not channel):
        raise UsageError("no bus: give -i INTERFACE -c CHANNEL, for example -i socketcan -c can0")
    found = Interface.of(channel) if name == "socketcan" else None
    told = found.in_words if found else "its bit rate cannot be asked"
    say(f"bus       {name} {channel}: {told}")
    return found


def _scan(args: DoctorOptions, interface: "Interface | None") -> "Iterator[BusFinding]":
    """Yield the bit rate of the bus, if the interface has another one."""
    from monitor.bus.bench.findings import BusFinding

    if interface is None or interface.kind != "can":
        raise UsageError(NO_SCAN)

    def is_right(bitrate: int) -> bool:
        health = heard(args.bus, SCAN_S)[1]
        frames, errors = (
            counted(health.frames, "frame"),
            counted(health.error_frames, "error frame"),
        )
        say(f"          {bitrate / 1000:g} kbit/s: {frames}, {errors}")
        return health.frames > health.error_frames

    bitrate = interface.scan(is_right)
    if bitrate is None:
        yield BusFinding("no_rate", {})
    elif bitrate != interface.bitrate:
        facts = {"name": interface.name, "bitrate": bitrate, "rate": f"{bitrate / 1000:g} kbit/s"}
        yield BusFinding("other_rate", facts)


def _listened(args: DoctorOptions, interface: "Interface | None") -> "Iterator[BusFinding]":
    """Listen, say what was seen, and yield what is wrong."""
    from monitor.bus.bench import findings
    from monitor.report.check import check

    setup = set_up(args, judges=False)
    block, health = heard(args.bus, args.seconds)
    say(
        f"listened  {args.seconds:g} s: {counted(len(block.key), 'frame')} of "
        f"{counted(len(set(block.key.tolist())), 'identifier')}, "
        f"{counted(health.error_frames, 'error frame')}"
    )
    yield from findings.of_bus(block, health, interface)
    if not len(block.key):
        return
    seen = findings.messages(block, setup.bus_map, args.seconds)
    if any(each.seen_hz for each in seen):
        say("\n".join([findings.HEAD, *(each.line for each in seen)]))
    result = check([block], setup.bus_map)
    whose = " and ".join(dbc.name for dbc, _ in setup.bus_map.pairs)
    whose += "" if args.pairs else " (the project's own ECU: no --dbc and --map are given)"
    yield from findings.of_messages(seen, block, result, whose)
    card = setup.model.card
    missing = result.missing((*card.input_names, card.output.name)) if args.model else []
    if missing := [name for name in missing if name not in {n for m in seen for n in m.names}]:
        facts = {"names": ", ".join(missing), "model": setup.model_path.name}
        yield findings.BusFinding("model", facts)
