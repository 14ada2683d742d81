"""``o2mon run``: judge a live bus."""

import gc
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from monitor.base.command_line import option_paths as paths
from monitor.base.command_line.parameters import Quiet
from monitor.base.files.outputs import unused
from monitor.bus.live.address import PageAddress, parse
from monitor.cli.diagnostics import DiagnosticsOptions, diagnostics
from monitor.cli.options import (
    NOT_JUDGED,
    Bus,
    JudgeOptions,
    ObdOptions,
    Seconds,
    bus_name,
    obd_poller,
    open_bus,
    say,
    set_up,
    tell_if_too_slow,
    write_outputs,
)
from monitor.cli.sinks import SinkOptions, open_sinks, sink_feed

if TYPE_CHECKING:
    from monitor.bus.attachment import Attachment
    from monitor.bus.live.feed import LiveFeed
    from monitor.bus.loop import Loop
    from monitor.bus.terminal import Out
    from monitor.pipeline.replay import Setup

EXAMPLES = """examples:
  o2mon run -i socketcan -c can0                         only listen
  o2mon run -i socketcan -c vcan0 --record drive.log --duration 600
  o2mon run -i socketcan -c can0 --memory o2.db --transmit
  chrt --fifo 50 taskset -c 1 o2mon run -i socketcan -c can0 --json-lines
  o2mon run -i socketcan -c can0 --obd --model own.onnx  poll OBD-II parameters
  o2mon run -i socketcan -c can0 --live 8765             live page on http://127.0.0.1:8765/
  o2mon run -i socketcan -c can0 --sink mqtt://broker/car --sink jsonl:car.jsonl

exit code: 0 done, 2 the bus cannot be used, 3 nothing could be judged"""


@dataclass(frozen=True, kw_only=True)
class LiveOptions:
    """The live page.

    live : serve a live page at this address; PORT alone means 127.0.0.1:PORT
    """

    live: Annotated[PageAddress | None, parse, "HOST:PORT"] = None


@dataclass(frozen=True, kw_only=True)
class RunOptions(JudgeOptions, DiagnosticsOptions, ObdOptions, LiveOptions, SinkOptions):
    """Options of a run.

    duration : stop after this time in s
    record : write all frames to this log (.log .asc .blf .trc .csv); if it exists, a number is
        added to the name
    quiet : print only the final verdict
    json_lines : print one JSON object per line
    """

    bus: Bus
    duration: Seconds | None = None
    record: Annotated[Path | None, paths.numbered, "LOG"] = None
    quiet: Quiet = False
    json_lines: bool = False


def run(args: RunOptions) -> int:
    """Judge a live bus."""
    from monitor.bus import loop as loops
    from monitor.bus.terminal import Out
    from monitor.bus.transmit import Transmitter
    from monitor.memory.store import Memory

    setup, sinks = set_up(args, obd=args.obd), open_sinks(args)
    record = unused(args.record) if args.record else None
    if record != args.record:
        print(f"o2mon: {args.record} is kept, this run is recorded in {record}", file=sys.stderr)
    out = Out(sys.stdout)
    memory = Memory(args.memory, hold=True) if args.memory else None
    if memory and memory.condition.says:
        _speaker(args, out)(memory.condition.says)
    with closing(memory) if memory else nullcontext(), open_bus(args.bus) as bus:
        name = bus_name(args.bus)
        loop = loops.Loop(
            bus,
            setup,
            memory=memory,
            record=record,
            trace=bool(args.html),
            reopen=lambda: open_bus(args.bus),
            say=_speaker(args, out),
        )
        loop.attachments.extend(_views(args, loop, out))
        if args.obd:
            tell_if_too_slow(args, setup, _speaker(args, out))
            loop.attachments.append(obd_poller(args, setup.bus_map, _speaker(args, out)))
        if args.transmit:
            loop.attachments.append(Transmitter(loop.pipeline.monitor))
        loop.attachments.extend(diagnostics(args, setup, loop, _speaker(args, out)))
        loop.attachments.extend(_live_feed(args, setup, loop, name, _speaker(args, out)))
        feed = sink_feed(args, sinks, loop, _speaker(args, out))
        loop.attachments.extend(feed)
        gc.collect()
        gc.freeze()  # collecting the loaded objects causes the longest pauses
        try:
            loops.run(loop, args.duration)
        finally:  # write the result even if the bus fails
            recording = loop.result(str(getattr(args.bus, "channel", None) or name))
            if feed:
                recording |= {"sinks": feed[0].entries()}
            for line in _ending(args, recording):
                say(line)
            write_outputs(args, setup, [recording], [loop.collector.trace()])
    return NOT_JUDGED if recording["not_judged"] else 0


def _speaker(args: RunOptions, out: "Out") -> Callable[[str], None]:
    """Return the function that prints the loop's messages."""
    from monitor.bus.terminal import json_line

    if args.json_lines:
        return lambda text: out.say(json_line("note", time.time(), {"text": text}))
    return out.say


def _views(args: RunOptions, loop: "Loop", out: "Out") -> "Iterator[Attachment]":
    """Yield the attachments that show the loop's state: screen, JSON or log lines, watchdog."""
    from monitor.bus.terminal import EventLines, JsonEvents, Screen, StatusLine
    from monitor.bus.watchdog import Watchdog

    monitor, health = loop.pipeline.monitor, loop.health
    view = StatusLine(monitor, health)
    if args.json_lines:
        view = JsonEvents(monitor, health, out)
    elif not args.quiet:
        kind = Screen if sys.stdout.isatty() else EventLines
        view = kind(monitor, health, loop.collector, out)
    yield view
    watchdog = Watchdog.of(view.line)
    if watchdog:
        yield watchdog


def _live_feed(
    args: LiveOptions, setup: "Setup", loop: "Loop", channel: str, say: Callable[[str], None]
) -> "Iterator[LiveFeed]":
    """Start the page's server if ``--live`` is given, say its address and yield what feeds it.

    Raises UsageError if the server cannot start.
    """
    if args.live is None:
        return
    from monitor.bus.live.feed import LiveFeed
    from monitor.bus.live.process import Server

    server = Server(args.live)
    say(f"live page: {server.address.url}")
    if not server.is_loopback:
        say(f"warning: everyone who reaches {server.address.host} can read the live page")
    yield LiveFeed(
        server,
        loop.pipeline.monitor,
        setup,
        health=lambda: loop.health.as_dict() | loop.pipeline.counters | loop.clock.counters.found,
        channel=channel,
        say=say,
    )


def _ending(args: RunOptions, recording: dict[str, Any]) -> Iterable[str]:
    """Return the closing lines about the whole run."""
    from monitor.bus.terminal import json_line
    from monitor.report.lines import print_recording, verdict_text

    if not args.json_lines:
        return print_recording(recording)
    wanted = "samples enabled_samples dtcs fault_flag completed not_judged counters"
    fields = {name: recording[name] for name in wanted.split()}
    fields |= {"sinks": recording["sinks"]} if "sinks" in recording else {}
    return [json_line("end", time.time(), {"verdict": verdict_text(recording), **fields})]
