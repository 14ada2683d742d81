"""``o2mon run``: judge a live bus."""

import gc
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
    bus_address,
    obd_poller,
    open_bus,
    say,
    set_up,
    tell_if_too_slow,
    write_outputs,
)
from monitor.cli.sinks import SinkOptions, appended, open_sinks, sink_feed, spoken

if TYPE_CHECKING:
    from monitor.bus.attachment import Attachment
    from monitor.bus.live.feed import LiveFeed
    from monitor.bus.loop import Loop
    from monitor.bus.terminal import Out
    from monitor.pipeline.replay import Setup

__all__ = ["EXAMPLES", "appended", "run"]
EXAMPLES = """examples:
  o2mon run -i socketcan -c can0                         only listen
  o2mon run -i socketcan -c vcan0 --record drive.log --duration 600
  o2mon run -i socketcan -c can0 --memory o2.db --transmit
  chrt --fifo 50 taskset -c 1 o2mon run -i socketcan -c can0 --quiet --sink jsonl:-
  o2mon run -i socketcan -c can0 --obd --model own.onnx  poll OBD-II parameters
  o2mon run -i socketcan -c can0 --live 8765             live page on http://127.0.0.1:8765/
  o2mon run -i socketcan -c can0 --sink mqtt://broker/car --sink jsonl:car.jsonl

exit code: 0 done, 2 the bus cannot be used, 3 nothing could be judged"""


@dataclass(frozen=True, kw_only=True)
class RunOptions(JudgeOptions, DiagnosticsOptions, ObdOptions, SinkOptions):
    """Options of a run.

    live : serve a live page at this address; PORT alone means 127.0.0.1:PORT
    duration : stop after this time in s
    record : write all frames to this log (.log .asc .blf .trc .csv); if it exists, a number is
        added to the name
    quiet : print only the final verdict
    """

    bus: Bus
    live: Annotated[PageAddress | None, parse, "HOST:PORT"] = None
    duration: Seconds | None = None
    record: Annotated[Path | None, paths.numbered, "LOG"] = None
    quiet: Quiet = False


def run(args: RunOptions) -> int:
    """Judge a live bus."""
    from monitor.bus import loop as loops
    from monitor.bus.terminal import Out
    from monitor.bus.transmit import Transmitter
    from monitor.memory.store import Memory
    from monitor.report.lines import print_recording

    setup, sinks = set_up(args, obd=args.obd), open_sinks(args)
    record = unused(args.record) if args.record else None
    if record != args.record:
        print(f"o2mon: {args.record} is kept, this run is recorded in {record}", file=sys.stderr)
    out = Out(spoken(args))
    memory = Memory(args.memory, hold=True) if args.memory else None
    if memory and memory.condition.says:
        out.say(memory.condition.says)
    with closing(memory) if memory else nullcontext(), open_bus(args.bus) as bus:
        name = " ".join(bus_address(args.bus)).strip()
        loop = loops.Loop(
            bus,
            setup,
            memory=memory,
            record=record,
            trace=bool(args.html),
            reopen=lambda: open_bus(args.bus),
            say=out.say,
        )
        loop.attachments.extend(_views(args, loop, out))
        if args.obd:
            poller = obd_poller(args, setup.bus_map, out.say)
            tell_if_too_slow(poller, setup, out.say)
            loop.attachments.append(poller)
        if args.transmit:
            loop.attachments.append(Transmitter(loop.pipeline.monitor))
        loop.attachments.extend(diagnostics(args, setup, loop, out.say))
        loop.attachments.extend(_live_feed(args, setup, loop, name, out.say))
        feed = sink_feed(args, sinks, loop, out.say)
        loop.attachments.extend(feed)
        gc.collect()
        gc.freeze()  # collecting the loaded objects causes the longest pauses
        try:
            loops.run(loop, args.duration)
        finally:  # write the result even if the bus fails
            recording = loop.result(bus_address(args.bus)[1] or name)
            if feed:
                recording |= {"sinks": feed[0].entries()}
            for line in print_recording(recording):
                say(line, out.stream)
            write_outputs(args, setup, [recording], [loop.collector.trace()], stream=out.stream)
    return NOT_JUDGED if recording["not_judged"] else 0


def _views(args: RunOptions, loop: "Loop", out: "Out") -> "Iterator[Attachment]":
    """Yield the attachments that show the loop's state: screen or log lines, watchdog."""
    from monitor.bus.terminal import EventLines, Screen, StatusLine
    from monitor.bus.watchdog import Watchdog

    monitor, health = loop.pipeline.monitor, loop.health
    view = StatusLine(monitor, health)
    if not args.quiet:
        kind = Screen if out.stream.isatty() else EventLines
        view = kind(monitor, health, loop.collector, out)
    yield view
    if watchdog := Watchdog.of(view.line):
        yield watchdog


def _live_feed(
    args: RunOptions, setup: "Setup", loop: "Loop", channel: str, say: Callable[[str], None]
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
        health=lambda: asdict(loop.health) | loop.pipeline.counters | loop.clock.counters.found,
        channel=channel,
        say=say,
    )
