"""``o2mon run``: judge a live bus."""

import argparse
from contextlib import closing, nullcontext
from pathlib import Path
from typing import Any

from monitor.cli.options import (
    NOT_JUDGED,
    add_bus,
    add_command,
    add_obd,
    add_outputs,
    add_setup,
    bus_name,
    check_outputs,
    obd_poller,
    open_bus,
    positive,
    say,
    set_up,
    write_outputs,
)

_RUN = """examples:
  o2mon run -i socketcan -c can0                         listen only
  o2mon run -i socketcan -c vcan0 --record drive.log --duration 600
  o2mon run -i socketcan -c can0 --memory o2.db --transmit
  o2mon run -i socketcan -c can0 --obd --model own.onnx  ask for OBD-II parameters

exit code: 0 done, 2 the bus cannot be used, 3 nothing could be judged"""


def add(commands: Any) -> None:
    """Add the subcommand."""
    run = add_command(commands, "run", "judge a live bus", _RUN, _run)
    add_bus(run)
    add_setup(run)
    run.add_argument("--duration", type=positive, metavar="S", help="stop after so many seconds")
    run.add_argument("--record", type=Path, metavar="LOG", help="write all frames to a log")
    run.add_argument("--transmit", action="store_true", help="send fault flag and codes")
    add_obd(run)
    run.add_argument("--quiet", action="store_true", help="print only the final verdict")
    add_outputs(run)


def _run(args: argparse.Namespace) -> int:
    from monitor.memory import Memory
    from monitor.run import Loop, run
    from monitor.sinks import print_recording
    from monitor.terminal import Lines
    from monitor.transmit import Transmitter

    check_outputs(args)
    setup = set_up(args)
    memory = Memory(args.memory) if args.memory else None
    with closing(memory) if memory else nullcontext(), open_bus(args) as bus:
        loop = Loop(
            bus,
            setup,
            memory=memory,
            record=args.record,
            trace=bool(args.html),
            say=say,
        )
        if not args.quiet:
            loop.attachments.append(Lines(loop.collector, say))
        if args.obd:
            loop.attachments.append(obd_poller(args, setup.bus_map))
        if args.transmit:
            loop.attachments.append(Transmitter(loop.pipeline.monitor))
        try:
            run(loop, args.duration)
        finally:  # a bus that fails takes no result with it
            recording = loop.result(str(getattr(args, "channel", None) or bus_name(args)))
            for line in print_recording(recording):
                say(line)
            write_outputs(args, setup, [recording], [loop.collector.trace()])
    return 0 if recording["completed"] or recording["fault_flag"] else NOT_JUDGED
