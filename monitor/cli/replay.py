"""``o2mon replay``: judge recorded drives."""

import argparse
from contextlib import closing, nullcontext
from typing import Any

from monitor.base.command_line import option_paths as paths
from monitor.cli.options import (
    LOGS,
    add_columns,
    add_command,
    add_outputs,
    add_setup,
    say,
    set_up,
    warn,
    write_outputs,
)
from monitor.cli.sinks import add_sinks, written_sinks

HELP = "judge recorded drives"
_REPLAY = """examples:
  o2mon replay drive.blf                     log of the project's own ECU, shipped model
  o2mon replay *.log --html report.html      several drives, shown on a web page
  o2mon replay drive.log --dbc engine.dbc --map engine.toml --model mine.onnx
  o2mon replay drive.msl --model mine.onnx   log of TunerStudio, COBB, Torque and others
  o2mon replay table.csv --model mine.onnx --columns names.toml

exit code: 0 judged and no fault, 1 a fault code is pending or confirmed, 2 unusable input,
3 not judged"""


def add(commands: Any) -> None:
    """Add the subcommand ``replay``."""
    replay = add_command(commands, "replay", HELP, _REPLAY, _replay)
    replay.add_argument("log", nargs="+", type=paths.read, metavar="LOG", help=LOGS)
    add_setup(replay)
    add_columns(replay)
    replay.add_argument("--windows", action="store_true", help="print every window")
    replay.add_argument("-q", "--quiet", action="store_true", help="print nothing per recording")
    add_outputs(replay)
    add_sinks(replay)


def _replay(args: argparse.Namespace) -> int:
    from monitor.frames.text.python_can import import_cantools_alone

    import_cantools_alone()
    from monitor.memory.store import Memory
    from monitor.pipeline import replay
    from monitor.report.lines import print_recording

    setup = set_up(args)
    memory = Memory(args.memory, hold=True) if args.memory else None
    if memory and memory.condition.says:
        warn(memory.condition.says)
    recordings, traces = [], []
    sinks = written_sinks(args)
    with (
        closing(memory) if memory else nullcontext(),
        closing(sinks) if sinks else nullcontext(),
    ):
        for recording, trace in replay.replay_all(
            args.log,
            setup,
            memory,
            trace=bool(args.html),
            listeners=sinks.listener if sinks else None,
        ):
            recordings.append(recording)
            traces.append(trace)
            for line in () if args.quiet else print_recording(recording, windows=args.windows):
                say(line)
    write_outputs(args, setup, recordings, traces)
    return replay.exit_code(recordings)
