"""``o2mon inject``: put faults into frames between two buses, or into a log or table."""

import argparse
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

from monitor.base.command_line import option_paths as paths
from monitor.base.command_line.option_kinds import BUS, LOG, TABLE, ActsOn
from monitor.base.command_line.parameters import OF_FRAMES, ColumnNames, Output
from monitor.base.command_line.signature import REPEATED
from monitor.base.errors import ConfigError, RecordingError, UsageError
from monitor.base.files.junit import JunitRun, junit_file
from monitor.cli.options import Seconds, SetupOptions, add_bus, bus_address, open_bus, say, set_up

if TYPE_CHECKING:
    import can

    from monitor.inject.expected import Recording
    from monitor.inject.scenario import Scenario
    from monitor.inject.side import Side
    from monitor.pipeline.replay import Setup

EXAMPLES = """examples:
  o2mon inject drive.log --out late.log --fault delay_rich_to_lean=0.8@60
  o2mon inject drive.log --scenario late.toml --assert
  o2mon inject drive.log --scenario tests/*.toml --assert --junit report.xml     for a CI server
  o2mon inject drive.msl --out late.csv --fault gain_low=0.5@60    a table or a logger's file
  o2mon inject -i socketcan -c can0 --to-channel can1 --fault gain_low=0.5@60-300
  o2mon inject -i socketcan -c vcan0 --to-channel vcan1 --scenario late.toml --assert --duration 900

A table or a logger's file is written as a table with canonical columns. Between buses, -i and -c
name the bus of the ECU, --to-... the other bus. A fault acts on frames or columns only. The ECU's
control loop does not see it: its sensor is wired to the ECU.

exit code: 0 done, with --assert all expectations are met; 1 an expectation is not met; 2 unusable
input"""

_HEARS_ITSELF = "udp_multicast"


def _add_buses(parser: argparse.ArgumentParser) -> None:
    add_bus(parser)
    add_bus(parser, prefix="to", group_title="bus arguments of the other side")


@dataclass(frozen=True, kw_only=True)
class InjectOptions(SetupOptions, ColumnNames):
    """Options of an injection.

    log : CAN log, table or log of a tuning tool instead of buses; -c names one of several in it
    out : log to write, of a table .csv
    fault : fault to inject, times in s after the first frame; may repeat
    scenario : files with faults and expectations; several are judged one after the other
    check : judge the changed frames and compare the result with the scenario's expectations
    junit : write JUnit XML for a CI server: one test for each scenario
    seed : seed of random faults (default: the scenario's)
    keep_counters : renumber alive counters, so that lost or doubled frames leave no gap in them
    duration : stop after this time in s (buses only)
    """

    log: Annotated[Path | None, paths.recording, "LOG"] = field(default=None, kw_only=False)
    out: Annotated[Path | None, paths.written, ActsOn([LOG, TABLE]), "LOG"] = None
    fault: Annotated[Sequence[str], REPEATED, "NAME[=SEVERITY][@START[-END]]"] = ()
    scenario: Annotated[Sequence[Path], paths.read, "TOML", {"action": "extend"}] = ()
    check: Annotated[bool, "--assert"] = False
    junit: Output = None
    seed: int | None = None
    keep_counters: Annotated[bool, OF_FRAMES] = False
    duration: Annotated[Seconds | None, ActsOn([BUS])] = None
    bus: Annotated[argparse.Namespace, _add_buses]


def also_written(args: InjectOptions) -> list[Path]:
    """Return the files for a scenario of several drives: --out with the number of the drive."""
    from monitor.base.files.outputs import numbered
    from monitor.inject.scenario import load

    n = 1
    if args.out and args.scenario:
        with suppress(ConfigError):  # the run tells of it
            n = load(args.scenario[0]).n_drives
    return [numbered(args.out, drive) for drive in range(1, n + 1)] if args.out and n > 1 else []


def run(args: InjectOptions) -> int:
    """Put faults into an engine's frames, or into a log."""
    with junit_file(args.junit, "o2mon.inject") as tests:
        return _inject(args, tests)


def _inject(args: InjectOptions, tests: JunitRun) -> int:
    from monitor.inject.expected import case, compare, table

    if args.log and not (args.out or args.check):
        raise UsageError("nothing to do with LOG: give --out, or --scenario and --assert")
    if len(args.scenario) > 1 and (args.out or not (args.log and args.check)):
        raise UsageError("several scenarios are for a LOG with --assert, without --out")
    if args.junit and not args.check:
        raise UsageError("--junit holds what --assert finds; give both")
    scenarios = _scenarios(args)
    if args.check and not all(scenario.expectations for scenario in scenarios.values()):
        raise UsageError("--assert needs a --scenario with an [[expect]]")
    setup = set_up(args, args.columns, judges=args.check)
    for name, scenario in scenarios.items():
        if len(scenarios) > 1:
            say(name)
        tests.name = name or tests.name
        recordings = (_drives if args.log else _buses)(args, scenario, setup)
        if args.check:
            rows = compare(scenario, recordings)
            for line in table(rows):
                say(line)
            tests.cases.append(case(name, rows))
    return 1 if any(case.said for case in tests.cases) else 0


def _scenarios(args: InjectOptions) -> "dict[str, Scenario]":
    """Return the scenarios by file and title."""
    from dataclasses import replace

    from monitor.inject.scenario import Scenario, load, parse_fault

    faults = tuple(map(parse_fault, args.fault))
    loaded = {str(path): load(path) for path in args.scenario} or {"": Scenario(())}
    return {
        f"{name}: {scenario.title}" if scenario.title else name: replace(
            scenario,
            faults=scenario.faults + faults,
            seed=scenario.seed if args.seed is None else args.seed,
            keep_counters=scenario.keep_counters or args.keep_counters,
        )
        for name, scenario in loaded.items()
    }


def _drives(args: InjectOptions, scenario: "Scenario", setup: "Setup") -> "list[Recording]":
    from monitor.inject.drives import play

    assert args.log
    files = dict(enumerate(also_written(args) or [args.out], 1))
    return play(args.log, scenario, setup, judges=args.check, place=files.get, say=say)


def _buses(args: InjectOptions, scenario: "Scenario", setup: "Setup") -> "list[Recording]":
    from monitor.bus.ending import ended_by_signals
    from monitor.bus.link.recorder import Recorder
    from monitor.frames.blocks import block_of
    from monitor.inject.gateway import Gateway
    from monitor.inject.injector import Injector
    from monitor.pipeline.replay import replay

    if "to_channel" not in args.bus:
        raise UsageError("give the other side with --to-channel (and --to-interface), or a LOG")
    if scenario.n_drives > 1:
        raise UsageError(f"{args.scenario[0]}: drives = {scenario.n_drives} is for a LOG only")
    other = _other_side(args.bus)
    names = [" ".join(bus_address(side)) for side in (args.bus, other)]
    if names[0] == names[1]:
        raise UsageError(f"both sides are {names[0]}, two buses are wanted")
    if any(name.startswith(_HEARS_ITSELF) for name in names):
        raise UsageError(
            f"{_HEARS_ITSELF} hears what it sends itself, "
            "so a gateway would pass the same frames round for ever; take vcan0 and vcan1"
        )
    injector = Injector(
        setup.bus_map, scenario.faults, seed=scenario.seed, keep_counters=scenario.keep_counters
    )
    with ExitStack() as stack:
        log = Path(stack.enter_context(TemporaryDirectory(prefix="o2mon-")), "bus.log")
        recorder = stack.enter_context(Recorder(log))
        taken = (lambda f: recorder.write(block_of([f]))) if args.check else lambda _: None
        here = _side(stack.enter_context(open_bus(args.bus)), args.bus, names[0])
        there = _side(stack.enter_context(open_bus(other)), other, names[1])
        gateway = Gateway(here, there, injector, taken)
        with ended_by_signals(gateway.stop):
            say(f"{' to '.join(names)}: {', '.join(map(str, scenario.faults))}")
            try:
                gateway.run(args.duration)
            finally:  # report the result even if the bus fails
                for line in gateway.lines():
                    say(line)
        recorder.close()
        if args.check and not log.stat().st_size:
            raise RecordingError(f"{names[0]}: no frame came from the ECU, nothing can be judged")
        n_changed = injector.counts.changed.total()
        return [replay(log, setup)[0] | {"n_changed": n_changed}] if args.check else []


def _side(bus: "can.BusABC", options: argparse.Namespace, name: str) -> "Side":
    from monitor.inject.side import Side

    return Side(bus, lambda: open_bus(options), say, name=name)


def _other_side(args: argparse.Namespace) -> argparse.Namespace:
    """Return the options of the other bus; its interface defaults to that of the ECU's bus."""
    options = {k.removeprefix("to_"): v for k, v in vars(args).items() if k.startswith("to_")}
    if "interface" not in options and "interface" in args:
        options["interface"] = args.interface
    return argparse.Namespace(**options)
