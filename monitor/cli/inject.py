"""``o2mon inject``: put faults into frames between two buses, or into a log or table."""

import argparse
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from monitor.base.command_line import option_paths as paths
from monitor.base.command_line.parameters import ColumnNames, Input
from monitor.base.command_line.signature import REPEATED
from monitor.base.errors import UsageError
from monitor.cli.options import (
    Seconds,
    SetupOptions,
    add_bus,
    bus_name,
    open_bus,
    say,
    set_up,
)

if TYPE_CHECKING:
    import can

    from monitor.base.types import Frame
    from monitor.decode.bus_map import BusMap
    from monitor.inject.expected import Recording
    from monitor.inject.scenario import Scenario
    from monitor.inject.side import Side
    from monitor.pipeline.replay import Setup

EXAMPLES = """examples:
  o2mon inject drive.log --out late.log --fault delay_rich_to_lean=0.8@60
  o2mon inject drive.log --scenario late.toml --assert
  o2mon inject drive.msl --out late.csv --fault gain_low=0.5@60    a table or a logger's file
  o2mon inject -i socketcan -c can0 --to-channel can1 --fault gain_low=0.5@60-300
  o2mon inject -i socketcan -c vcan0 --to-channel vcan1 --scenario late.toml --assert --duration 900

A table or a logger's file is written as a table with canonical columns. Between buses, -i and -c
name the bus of the ECU, --to-... the other bus. A fault acts on frames or columns only. The ECU's
control loop does not see it: its sensor is wired to the ECU.

exit code: 0 done, with --assert all expectations are met; 1 an expectation is not met; 2 unusable
input"""

_HEARS_ITSELF = "udp_multicast"
_NOTHING = "nothing to do with LOG: give --out, or --scenario and --assert"


def _add_buses(parser: argparse.ArgumentParser) -> None:
    from can.cli import add_bus_arguments

    add_bus(parser)
    add_bus_arguments(parser, prefix="to", group_title="bus arguments of the other side")


@dataclass(frozen=True, kw_only=True)
class InjectOptions(SetupOptions, ColumnNames):
    """Options of an injection.

    log : CAN log, table or log of a tuning tool instead of buses
    out : log to write, of a table .csv
    fault : fault to inject, times in s after the first frame; may repeat
    scenario : faults and expectations
    check : judge the changed frames and compare the result with the scenario's expectations
    seed : seed of random faults (default: the scenario's)
    keep_counters : renumber alive counters, so that lost or doubled frames leave no gap in them
    duration : stop after this time in s (buses only)
    """

    log: Annotated[Input | None, "LOG"] = field(default=None, kw_only=False)
    out: Annotated[Path | None, paths.written, "LOG"] = None
    fault: Annotated[Sequence[str], REPEATED, "NAME[=SEVERITY][@START[-END]]"] = ()
    scenario: Annotated[Input | None, "TOML"] = None
    check: Annotated[bool, "--assert"] = False
    seed: int | None = None
    keep_counters: bool = False
    duration: Seconds | None = None
    bus: Annotated[argparse.Namespace, _add_buses]


def run(args: InjectOptions) -> int:
    """Put faults into an engine's frames, or into a log."""
    from monitor.grid.tables import is_table

    scenario = _scenario(args)
    if args.log and (bus_name(args.bus) or "to_channel" in args.bus or args.duration):
        raise UsageError("give either a LOG or two buses (-i, -c, --to-channel), not both")
    if args.check and not scenario.expectations:
        raise UsageError("--assert needs a --scenario with an [[expect]]")
    setup = set_up(args, args.columns) if args.check else None
    if args.log and is_table(args.log):
        recordings = _table(args, args.log, scenario, setup)
    else:
        bus_map = setup.bus_map if setup else _bus_map(args)
        if args.log:
            recordings = _logs(args, args.log, scenario, bus_map, setup)
        else:
            recordings = _buses(args, scenario, bus_map, setup)
    if not args.check:
        return 0
    from monitor.inject.expected import compare, table

    rows = compare(scenario, recordings)
    for line in table(rows):
        say(line)
    return 0 if all(row.met for row in rows) else 1


def _scenario(args: InjectOptions) -> "Scenario":
    from dataclasses import replace

    from monitor.inject.scenario import Scenario, load, parse_fault

    scenario = load(args.scenario) if args.scenario else Scenario(())
    faults = (*scenario.faults, *map(parse_fault, args.fault))
    return replace(
        scenario,
        faults=faults,
        seed=scenario.seed if args.seed is None else args.seed,
        keep_counters=scenario.keep_counters or args.keep_counters,
    )


def _bus_map(args: InjectOptions) -> "BusMap":
    import dbc
    from monitor.decode.bus_map import load_pairs

    default = [(dbc.path("o2_ecu.dbc"), dbc.path("o2_ecu.toml"))]
    return load_pairs(args.pairs or default)


def _logs(
    args: InjectOptions,
    log: Path,
    scenario: "Scenario",
    bus_map: "BusMap",
    setup: "Setup | None",
) -> "list[Recording]":
    from monitor.frames.logs import read_frames
    from monitor.inject.expected import FrameJudge, fresh_memory
    from monitor.inject.gateway import write_log
    from monitor.inject.injector import Injector

    if not (args.out or args.check):
        raise UsageError(_NOTHING)
    recordings: list[Recording] = []
    with ExitStack() as stack:
        memory = stack.enter_context(fresh_memory()) if setup else None
        for drive in range(1, scenario.n_drives + 1):
            injector = Injector(
                bus_map,
                scenario.faults_of(drive),
                seed=scenario.seed + drive - 1,
                keep_counters=scenario.keep_counters,
            )
            judge = FrameJudge(setup, memory) if setup and memory else None
            out = _place(args, drive, scenario.n_drives)
            frames = injector.stream(read_frames(log))
            frames = _seen(frames, judge.push) if judge else frames
            n = write_log(out, frames) if out else sum(1 for _ in frames)
            for line in injector.counts.lines():
                say(f"{out or log}: {line}")
            if n == 0:
                raise UsageError(f"{log}: no frame is left to judge or write")
            if judge:
                recordings.append(judge.finish(str(out or log)))
    return recordings


def _table(
    args: InjectOptions, log: Path, scenario: "Scenario", setup: "Setup | None"
) -> "list[Recording]":
    from monitor.grid.tables import read_table
    from monitor.inject.expected import fresh_memory
    from monitor.inject.table_faults import with_faults, write_own
    from monitor.model.step import Model
    from monitor.pipeline.recordings import RecordingReader, table_of_model
    from monitor.pipeline.replay import judged

    if not (args.out or args.check):
        raise UsageError(_NOTHING)
    model = setup.model if setup else Model.load(args.model) if args.model else None
    if model:
        table = table_of_model(log, args.columns, model.card)
    else:
        table = read_table(log, args.columns)
    recordings: list[Recording] = []
    with fresh_memory() as memory:
        for drive in range(1, scenario.n_drives + 1):
            seed = scenario.seed + drive - 1
            changed, n = with_faults(table, scenario.faults_of(drive), seed)
            out = _place(args, drive, scenario.n_drives)
            if out:
                write_own(out, changed)
            say(f"{out or log}: lambda changed in {n} of {len(changed.t_ns)} rows")
            if setup:
                reader = RecordingReader(setup.bus_map, setup.model.card)
                recordings.append(judged(reader.table(changed), None, setup, memory)[0])
    return recordings


def _place(args: InjectOptions, drive: int, n_drives: int) -> Path | None:
    """Return the file to write for a drive: the one of --out, with the number of the drive."""
    from monitor.base.files.outputs import check, check_replaced, numbered

    if args.out is None or n_drives == 1:
        return args.out
    out = numbered(args.out, drive)
    check((out,), (args.log, args.scenario, *args.dbc, *args.map))
    if not args.bus.force:
        check_replaced((out,))
    return out


def _seen(frames: "Iterable[Frame]", take: Any) -> "Iterator[Frame]":
    for frame in frames:
        take(frame)
        yield frame


def _buses(
    args: InjectOptions, scenario: "Scenario", bus_map: "BusMap", setup: "Setup | None"
) -> "list[Recording]":
    from monitor.bus.ending import ended_by_signals
    from monitor.inject.expected import FrameJudge, fresh_memory
    from monitor.inject.gateway import Gateway
    from monitor.inject.injector import Injector

    if args.out:
        raise UsageError("--out is for a LOG; o2mon run --record writes what is on a bus")
    if "to_channel" not in args.bus:
        raise UsageError("give the other side with --to-channel (and --to-interface), or a LOG")
    if scenario.n_drives > 1:
        raise UsageError(f"{args.scenario}: drives = {scenario.n_drives} is for a LOG, not a bus")
    other = _other_side(args.bus)
    if bus_name(args.bus) == bus_name(other):
        raise UsageError(f"both sides are {bus_name(args.bus)}, two buses are wanted")
    for side in (args.bus, other):
        if getattr(side, "interface", None) == _HEARS_ITSELF:
            raise UsageError(
                f"{bus_name(side)}: {_HEARS_ITSELF} hears what it sends itself, "
                "so a gateway would pass the same frames round for ever"
            )
    injector = Injector(
        bus_map, scenario.faults, seed=scenario.seed, keep_counters=scenario.keep_counters
    )
    with ExitStack() as stack:
        memory = stack.enter_context(fresh_memory()) if setup else None
        judge = FrameJudge(setup, memory) if setup and memory else None
        here = _side(stack.enter_context(open_bus(args.bus)), args.bus)
        there = _side(stack.enter_context(open_bus(other)), other)
        gateway = Gateway(here, there, injector, judge.push if judge else lambda _: None)
        with ended_by_signals(gateway.stop):
            say(
                f"{bus_name(args.bus)} to {bus_name(other)}: {', '.join(map(str, scenario.faults))}"
            )
            try:
                gateway.run(args.duration)
            finally:  # report the result even if the bus fails
                for line in gateway.lines():
                    say(line)
        return [judge.finish(bus_name(other))] if judge else []


def _side(bus: "can.BusABC", options: argparse.Namespace) -> "Side":
    from monitor.bus.link.connection import Connection
    from monitor.inject.side import Side

    return Side(Connection(bus, lambda: open_bus(options), say, name=bus_name(options)))


def _other_side(args: argparse.Namespace) -> argparse.Namespace:
    """Return the options of the other bus; its interface defaults to that of the ECU's bus."""
    options = {k.removeprefix("to_"): v for k, v in vars(args).items() if k.startswith("to_")}
    if "interface" not in options and "interface" in args:
        options["interface"] = args.interface
    return argparse.Namespace(**options)
