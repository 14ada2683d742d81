"""``o2mon doctor``: say what is wrong with a bus or a sensor, and what to do about it."""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from monitor.base.command_line import option_paths as paths
from monitor.base.command_line.option_kinds import BUS, ActsOn
from monitor.base.command_line.parameters import ColumnNames
from monitor.base.counts import counted
from monitor.base.errors import UsageError
from monitor.cli.check import heard
from monitor.cli.options import (
    LOGS,
    NOT_JUDGED,
    Bus,
    Seconds,
    SetupOptions,
    bus_address,
    positive,
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
  o2mon doctor friday.msl --healthy monday.msl tuesday.msl wednesday.msl
  o2mon doctor friday.msl --model doctor/car.onnx --out friday

exit code: 0 nothing wrong was found, 3 something was, 2 the bus cannot be used; with LOG that of
o2mon replay"""
_LOG = {"help": f"{LOGS}; without it, a bus"}
SCAN_S = 1.0  # at each bit rate


@dataclass(frozen=True, kw_only=True)
class DoctorOptions(SetupOptions, ColumnNames):
    """Options of a diagnosis.

    healthy : logs of the same car with a sensor that you trust: o2train fits a model to them
    out : folder for the page of LOG, the model and the tables
    budget : work of the fit in minutes
    seconds : time to listen, in s
    scan : try the usual bit rates, listen-only, as root, then restore the interface; other programs
        that use it hear nothing meanwhile
    """

    log: Annotated[Sequence[Path], paths.recording, "LOG", _LOG] = field(default=(), kw_only=False)
    healthy: Annotated[Sequence[Path], paths.recording, "LOG"] = ()
    out: Annotated[Path, paths.folder, "DIR"] = Path("doctor")
    budget: Annotated[float, positive, "MIN"] = 10.0
    bus: Bus
    seconds: Annotated[Seconds, ActsOn([BUS])] = 5.0
    scan: Annotated[bool, ActsOn([BUS])] = False


def also_written(args: argparse.Namespace) -> list[Path]:
    """Return the page beside the files that the steps write and check themselves."""
    return [args.out / "report.html"] if args.log else []


def run(args: DoctorOptions) -> int:
    """Listen to a bus and say what is wrong with it, a sentence each, and what to do. It sends
    nothing. What is asked: bit rate and error counters of the interface, error frames, missing
    acknowledgement, the messages of the map with their rates, two senders of one message, the
    values of the signals.

    With LOG: check it, fit a model to healthy logs or take one, judge the sensor, estimate tables
    for the ECU, and write one page. Each step is a command that is printed.
    """
    if args.log:
        from monitor.cli.log_doctor import diagnosed

        return diagnosed(args)
    from monitor.bus.bench.findings import of_interface

    interface = _interface(args)
    found = [*_scan(args, interface)] if args.scan else []
    found = found or [*(of_interface(interface) if interface else ())]
    found = found or [*_listened(args, interface)]
    by_remedy: dict[str, list[str]] = {}
    for said, remedy in (each.lines for each in found):
        by_remedy.setdefault(remedy, []).append(said)
    for number, (remedy, each) in enumerate(by_remedy.items(), 1):
        say("\n   ".join([f"{number}. {each[0]}", *each[1:], f"-> {remedy}"]))
    if not found:
        say("nothing wrong was found")
    return NOT_JUDGED if found else 0


def _interface(args: DoctorOptions) -> "Interface | None":
    """Return the interface if it is one of SocketCAN, and say what it tells of itself."""
    from monitor.bus.bench.interface import Interface

    name, channel = bus_address(args.bus)
    if args.healthy or not name or (name == "socketcan" and not channel):
        raise UsageError(
            "nothing to examine: give a LOG, or a bus (-i INTERFACE -c CHANNEL, for example "
            "-i socketcan -c can0)"
        )
    found = Interface.of(channel) if name == "socketcan" else None
    told = found.in_words if found else "its bit rate cannot be asked"
    say(f"bus       {name} {channel}: {told}")
    return found


def _scan(args: DoctorOptions, interface: "Interface | None") -> "Iterator[BusFinding]":
    """Yield the bit rate of the bus, if the interface has another one."""
    from monitor.bus.bench.findings import BusFinding

    if interface is None or interface.kind != "can":
        raise UsageError("--scan needs a SocketCAN interface with a bit rate")

    def is_right(bitrate: int) -> bool:
        health = heard(args.bus, SCAN_S)[1]
        frames = counted(health.frames, "frame")
        errors = counted(health.error_frames, "error frame")
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
    from monitor.pipeline.names import lacking_names
    from monitor.report.check import check

    setup = set_up(args, judges=False)
    block, health, silent_s = heard(args.bus, args.seconds)
    say(
        f"listened  {args.seconds:g} s: {counted(len(block.key), 'frame')} of "
        f"{counted(len(set(block.key.tolist())), 'identifier')}, "
        f"{counted(health.error_frames, 'error frame')}"
    )
    yield from findings.of_bus(block, health, interface)
    if not len(block.key):
        return
    seen = findings.messages(block, setup.bus_map, args.seconds - silent_s)
    if any(each.seen_hz for each in seen):
        say("\n".join([findings.HEAD, *(each.line for each in seen)]))
    result = check([block], setup.bus_map, silent_s)
    whose = " and ".join(dbc.name for dbc, _ in setup.bus_map.pairs)
    whose += "" if args.pairs else " (the project's own ECU: no --dbc and --map are given)"
    yield from findings.of_messages(seen, block, result, whose)
    provided = (*setup.bus_map.names, *(each.name for each in result.signals))
    if args.model and (lacking := lacking_names(setup.model.card, provided)):
        facts = {"names": ", ".join(lacking), "model": setup.model.path.name}
        yield findings.BusFinding("model", facts)
