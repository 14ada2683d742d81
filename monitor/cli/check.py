"""``o2mon check``: say which mapped signals are present."""

import argparse
import time
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from monitor.base.command_line import option_paths as paths
from monitor.base.command_line.option_kinds import BUS, ActsOn
from monitor.base.command_line.parameters import ColumnNames
from monitor.base.errors import UsageError
from monitor.base.signals import OUTPUT
from monitor.cli.options import (
    LOGS,
    NOT_JUDGED,
    Bus,
    ObdOptions,
    Seconds,
    SetupOptions,
    Unusable,
    bus_address,
    obd_poller,
    open_bus,
    say,
    set_up,
)

if TYPE_CHECKING:
    from monitor.base.types import FrameBlock
    from monitor.bus.link.port import BusHealth
    from monitor.bus.polling.poller import ObdPoller
    from monitor.pipeline.replay import Setup
    from monitor.report.check import CheckResult
    from monitor.report.check_table import TableCheck

EXAMPLES = """examples:
  o2mon check drive.msl                                  what a logger's file holds
  o2mon check drive.csv --write-profile my.toml          a profile to edit for a new logger
  o2mon check -i socketcan -c can0 --seconds 10 --dbc engine.dbc --map engine.toml
  o2mon check -i socketcan -c can0 --obd                 ask for OBD-II parameters

exit code: 0 every signal of the model is present, 3 a signal is missing"""
_LOG = {"help": f"{LOGS}; without it, a bus"}


@dataclass(frozen=True, kw_only=True)
class CheckOptions(SetupOptions, ColumnNames, ObdOptions):
    """Options of a check.

    write_profile : write a profile to edit, with the columns of LOG that names, units and values
        tell
    seconds : time to listen to a bus, in s
    """

    log: Annotated[Sequence[Path], paths.recording, "LOG", _LOG] = field(default=(), kw_only=False)
    bus: Bus
    write_profile: Annotated[Path | None, paths.written, "FILE"] = None
    seconds: Annotated[Seconds, ActsOn([BUS])] = 5.0


def run(args: CheckOptions) -> int:
    """Say which signals are there, log by log; return the worst exit code."""
    if args.write_profile:
        return _write_profile(args.log, args.write_profile)
    codes, unusable = list[int](), Unusable()
    for log in args.log or (None,):
        with unusable.set_aside(log or Path()):
            codes.append(_check(args, log))
    unusable.end()
    return max(codes)


def _check(args: CheckOptions, path: Path | None) -> int:
    """Say which signals a log has, or a bus."""
    from monitor.decode.log_blocks import log_blocks
    from monitor.frames.blocks import LogCounters
    from monitor.grid.tables import is_table
    from monitor.report.check import check

    if path and is_table(path):
        return _check_table(args, path)
    if not (path or any(bus_address(args.bus))):
        raise UsageError(
            "nothing to check: give a LOG or a bus (-i and -c, for example -i socketcan -c can0)"
        )
    setup = set_up(args, args.columns, obd=args.obd, judges=False)
    log = LogCounters()
    if path:
        result = check(log_blocks(path, setup.bus_map, log), setup.bus_map)
    else:
        poller = obd_poller(args, setup.bus_map) if args.obd else None
        block, health, silent_s = heard(args.bus, args.seconds, poller)
        result = check([block], setup.bus_map, silent_s)
        if poller:
            poller.close()
            if not poller.counters.answers:
                say("nobody answers: ignition off, a listen-only interface, or a gateway between?")
        if health.transmit_errors:
            say(f"{health.transmit_errors} could not be sent")
        if engine := result.standing(setup.config.plausibility.engine_running_rpm):
            say(engine)
    notes = [*(f"log: {n}" for n in log.notes), *(f"database: {n}" for n in setup.bus_map.notes)]
    say("\n".join([*([path.name] if path else []), *result.lines(), *notes]))
    return _concluded(result, setup, path, result.stale)


def _concluded(
    result: "CheckResult | TableCheck", setup: "Setup", log: Path | None, stale: Sequence[str] = ()
) -> int:
    """Say whether the model has its signals, and what else holds up a verdict; return the code."""
    missing = result.missing((*setup.model.card.input_names, setup.model.card.output.name))
    if missing:
        say(f"missing for the model: {', '.join(missing)}")
        maps = "".join(path.read_text(errors="replace") for _, path in setup.bus_map.pairs)
        if commented := [n for n in missing if f" {n} = {{" in maps and f"\n{n} = {{" not in maps]:
            say(f"comments of the map, to be confirmed: {', '.join(commented)}")
        return NOT_JUDGED
    held = f"every signal, but stale at times: {', '.join(stale)}" if stale else "all its signals"
    say(f"the model has {held}")
    if log is None:
        return 0
    from monitor.pipeline.recordings import RecordingReader
    from monitor.report.check import CheckResult, held_up

    card = setup.model.card
    if not card.limits:
        say("the model has no decision limits: o2mon replay cannot judge with it; fit it to more")
    reader = RecordingReader(setup.bus_map, card, setup.columns)
    opened = reader.open(log) if isinstance(result, CheckResult) else reader.table(result.table)
    for cause in held_up(opened, card, setup.config):
        say(f"would hold up a verdict: {cause.in_words}")
    return 0


def _check_table(args: CheckOptions, log: Path) -> int:
    from monitor.grid.tables import rename
    from monitor.mapping.profile_proposal import unusual
    from monitor.report.check_table import advice, check_table

    result = check_table(log, args.columns) if args.model is None else None
    if result and result.table.profile:
        say("\n".join([*result.lines(), *unusual(result), advice(result)]))
        return NOT_JUDGED if result.missing([OUTPUT]) or result.is_output_pinned else 0
    setup = set_up(args, args.columns, obd=args.obd, judges=False)
    result = result or check_table(log, args.columns, setup.model.card)
    say("\n".join([*result.lines(), *unusual(result)]))
    code = _concluded(result, setup, log)
    if code and (own := rename(result.table)):
        say(own)
    return code


def _write_profile(logs: Sequence[Path], out: Path) -> int:
    from monitor.base.files.outputs import write_text
    from monitor.frames.profiles.profile import profile_of
    from monitor.frames.tables.readers import open_table
    from monitor.grid.tables import is_table
    from monitor.mapping.profile_proposal import proposed

    if len(logs) != 1 or not is_table(logs[0]):
        raise UsageError("--write-profile needs one LOG that is no CAN log: these want o2mon map")
    text = proposed(open_table(logs[0]))
    profile_of(tomllib.loads(text), out)  # what is written can be read
    write_text(out, text)
    say(f"{out}: a profile to edit; try it with o2mon check {logs[0]} --profile {out}")
    return 0


def heard(
    bus: argparse.Namespace, seconds: float, poller: "ObdPoller | None" = None
) -> "tuple[FrameBlock, BusHealth, float]":
    """Return a bus's frames, its health, and the silence at the end in s.

    seconds : time to listen
    """
    from monitor.bus.link.port import ANSWER_S, BusHealth, Port
    from monitor.frames.blocks import block_of, frames_of, joined

    health, blocks, heard_s = BusHealth(), [block_of([])], time.monotonic()
    with open_bus(bus) as opened:
        port = Port(opened, health)
        until_s = time.monotonic() + seconds
        while (now_s := time.monotonic()) < until_s:
            for request in poller.work(now_s) if poller else ():
                port.send(request)
            due_s = min(poller.due_s, until_s) if poller else until_s
            block = port.receive(min(max(due_s - now_s, 0.0), ANSWER_S))
            heard_s = time.monotonic() if len(block.key) else heard_s
            if poller:
                for frame in frames_of(block):
                    poller.receive(frame)
            blocks.append(block)
    return joined(blocks), health, time.monotonic() - heard_s
