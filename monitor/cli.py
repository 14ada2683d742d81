"""The command ``o2mon``."""

import argparse
import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from monitor.errors import BusError, O2Error, UsageError

if TYPE_CHECKING:
    import can

    from monitor.replay import Setup
    from monitor.types import Frame

USAGE_ERROR, NOT_JUDGED, INTERNAL_ERROR = 2, 3, 4

_REPLAY = """examples:
  o2mon replay drive.blf                     a log of the project's own ECU, shipped model
  o2mon replay *.log --html report.html      several drives and a report to look at
  o2mon replay drive.log --dbc engine.dbc --map engine.toml --model mine.onnx
  o2mon replay table.csv --model mine.onnx --columns names.toml

exit code: 0 judged and no fault, 1 a fault code is pending or confirmed, 2 unusable input,
3 not judged"""
_RUN = """examples:
  o2mon run -i socketcan -c can0                         listen only
  o2mon run -i socketcan -c vcan0 --record drive.log --duration 600
  o2mon run -i socketcan -c can0 --memory o2.db --transmit

exit code: 0 done, 2 the bus cannot be used, 3 nothing could be judged"""
_CHECK = """examples:
  o2mon check drive.log
  o2mon check -i socketcan -c can0 --seconds 10 --dbc engine.dbc --map engine.toml

exit code: 0 all the model needs is there, 3 something is missing"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``o2mon``; return the exit code."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    try:
        args = _parser().parse_args(argv)
        return int(args.func(args))
    except O2Error as error:
        print(f"o2mon: {error}", file=sys.stderr)
        return USAGE_ERROR
    except KeyboardInterrupt:
        return 130
    except Exception as error:  # a bug of ours must not look like a fault of the sensor
        if os.environ.get("O2_TRACEBACK"):
            raise
        print(f"o2mon: internal error: {type(error).__name__}: {error}", file=sys.stderr)
        return INTERNAL_ERROR


def _positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text}: a positive number is wanted")
    return value


def _check_outputs(args: argparse.Namespace) -> None:
    """Find out before the work whether its result can be written.

    Raises UsageError.
    """
    for path in (args.json, args.html, getattr(args, "record", None)):
        if path is not None and not path.absolute().parent.is_dir():
            raise UsageError(f"{path}: the folder does not exist")


def _say(line: str) -> None:
    """Print a line; when nobody reads any more go on without, for the verdict still counts."""
    try:
        print(line, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _parser() -> argparse.ArgumentParser:
    from monitor import __version__

    parser = argparse.ArgumentParser(
        prog="o2mon", description="Monitor of the upstream wideband oxygen sensor."
    )
    parser.add_argument("--version", action="version", version=f"o2mon {__version__}")
    commands = parser.add_subparsers(required=True, metavar="command")

    replay = _add(commands, "replay", "judge recorded drives", _REPLAY, _replay)
    replay.add_argument("log", nargs="+", type=Path, metavar="LOG", help="CAN log or table")
    _add_setup(replay)
    replay.add_argument("--columns", type=Path, help="TOML: canonical name = column of the table")
    replay.add_argument("--windows", action="store_true", help="print every window")
    replay.add_argument("--quiet", action="store_true", help="print no verdicts")
    _add_outputs(replay)

    run = _add(commands, "run", "judge a live bus", _RUN, _run)
    _add_bus(run)
    _add_setup(run)
    run.add_argument("--duration", type=_positive, metavar="S", help="stop after so many seconds")
    run.add_argument("--record", type=Path, metavar="LOG", help="write all frames to a log")
    run.add_argument("--transmit", action="store_true", help="send fault flag and codes")
    run.add_argument("--quiet", action="store_true", help="print only the final verdict")
    _add_outputs(run)

    check = _add(commands, "check", "say which signals are there", _CHECK, _check)
    check.add_argument("log", nargs="?", type=Path, metavar="LOG", help="CAN log instead of a bus")
    _add_bus(check)
    _add_setup(check, memory=False)
    check.add_argument("--seconds", type=_positive, default=5.0, help="how long to listen to a bus")
    return parser


def _add(commands: Any, name: str, text: str, examples: str, func: Any) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = commands.add_parser(
        name,
        help=text,
        description=text.capitalize() + ".",
        epilog=examples,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(func=func)
    return parser


def _add_setup(parser: argparse.ArgumentParser, *, memory: bool = True) -> None:
    parser.add_argument("--model", type=Path, help="ONNX model with its card (default: shipped)")
    parser.add_argument("--dbc", type=Path, action="append", default=[], help="CAN database")
    parser.add_argument("--map", type=Path, action="append", default=[], help="its signal map")
    parser.add_argument("--config", type=Path, help="TOML that changes shipped settings")
    if memory:
        parser.add_argument(
            "--memory", type=Path, metavar="FILE", help="fault memory to go on from"
        )


def _add_outputs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the result as JSON")
    parser.add_argument("--html", type=Path, metavar="OUT", help="write a report")


def _add_bus(parser: argparse.ArgumentParser) -> None:
    from can.cli import add_bus_arguments

    add_bus_arguments(parser)


def _set_up(args: argparse.Namespace) -> "Setup":
    from monitor import config, replay

    if len(args.dbc) != len(args.map):
        raise UsageError(
            f"--dbc and --map come in pairs: {len(args.dbc)} --dbc, {len(args.map)} --map"
        )
    pairs = list(zip(args.dbc, args.map, strict=True))
    columns = getattr(args, "columns", None)
    return replay.set_up(args.model, pairs, config.load(args.config), columns)


def _replay(args: argparse.Namespace) -> int:
    from monitor import replay
    from monitor.memory import Memory
    from monitor.sinks import print_recording

    _check_outputs(args)
    setup = _set_up(args)
    memory = Memory(args.memory) if args.memory else None
    recordings, traces = [], []
    with closing(memory) if memory else nullcontext():
        for recording, trace in replay.replay_all(args.log, setup, memory, trace=bool(args.html)):
            recordings.append(recording)
            traces.append(trace)
            for line in () if args.quiet else print_recording(recording, windows=args.windows):
                _say(line)
    _write_outputs(args, setup, recordings, traces)
    return replay.exit_code(recordings)


def _write_outputs(
    args: argparse.Namespace, setup: "Setup", recordings: list[dict[str, Any]], traces: list[Any]
) -> None:
    from monitor import replay, sinks
    from monitor.report import write_report

    result = replay.result_of(recordings, setup)
    try:
        if args.json:
            sinks.write_json(args.json, result)
        if args.html:
            write_report(
                args.html,
                result,
                traces,
                title="Oxygen sensor monitor",
                model_info=replay.model_info(setup),
            )
            _say(f"report: {args.html}")
    except OSError as error:
        raise UsageError(f"{error.filename}: {error.strerror}") from None


def _bus_name(args: argparse.Namespace) -> str:
    """Return interface and channel as given; python-can leaves out what was not."""
    given = (getattr(args, name, None) for name in ("interface", "channel"))
    return " ".join(str(part) for part in given if part)


def _open_bus(args: argparse.Namespace) -> "can.BusABC":
    import can
    from can.cli import create_bus_from_namespace

    try:
        return create_bus_from_namespace(args)
    except (
        can.CanError,
        argparse.ArgumentError,
        OSError,
        ValueError,
        ImportError,
        NotImplementedError,
    ) as error:
        where = _bus_name(args) or "no -i and -c given"
        cause = error.__cause__ or error
        reason = str(cause) or type(cause).__name__
        raise BusError(f"cannot open the bus ({where}): {reason}") from None


def _run(args: argparse.Namespace) -> int:
    from monitor.memory import Memory
    from monitor.run import Loop, run
    from monitor.sinks import print_recording

    _check_outputs(args)
    setup = _set_up(args)
    memory = Memory(args.memory) if args.memory else None
    with closing(memory) if memory else nullcontext(), _open_bus(args) as bus:
        loop = Loop(
            bus,
            setup,
            memory=memory,
            record=args.record,
            transmit=args.transmit,
            trace=bool(args.html),
            say=(lambda _: None) if args.quiet else _say,
        )
        try:
            run(loop, args.duration)
        finally:  # a bus that fails takes no result with it
            recording = loop.result(str(getattr(args, "channel", None) or _bus_name(args)))
            for line in print_recording(recording):
                _say(line)
            _write_outputs(args, setup, [recording], [loop.collector.trace()])
    return 0 if recording["completed"] or recording["fault_flag"] else NOT_JUDGED


def _check(args: argparse.Namespace) -> int:
    from monitor.check import check
    from monitor.sources import read_frames

    if args.log and _bus_name(args):
        raise UsageError("give either a LOG or a bus (-i, -c), not both")
    setup = _set_up(args)
    if args.log:
        result = check(read_frames(args.log), setup.bus_map)
    else:
        with _open_bus(args) as bus:
            result = check(_listen(bus, args.seconds), setup.bus_map)
    for line in result.lines():
        _say(line)
    card = setup.model.card
    missing = result.missing((*card.input_names, card.output.name))
    _say(f"the model lacks: {', '.join(missing)}" if missing else "the model has all it needs")
    return NOT_JUDGED if missing else 0


def _listen(bus: "can.BusABC", seconds: float) -> "Iterator[Frame]":
    from monitor.run import receive
    from monitor.sources import frame_of

    until_s = time.monotonic() + seconds
    while (left_s := until_s - time.monotonic()) > 0:
        message = receive(bus, left_s)
        if message is not None and not message.is_error_frame and not message.is_remote_frame:
            yield frame_of(message)


if __name__ == "__main__":
    sys.exit(main())
