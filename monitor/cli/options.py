"""What the subcommands of ``o2mon`` share: options, opening a bus, writing results."""

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from monitor.base import outputs
from monitor.base.errors import BusError, UsageError

if TYPE_CHECKING:
    import can

    from monitor.bus.polling.poller import ObdPoller
    from monitor.decode.bus_map import BusMap
    from monitor.report.replay import Setup

NOT_JUDGED = 3


def positive(text: str) -> float:
    """Return a positive number given as an option."""
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text}: a positive number is wanted")
    return value


def hexadecimal(text: str) -> int:
    """Return a whole number given as hexadecimal digits."""
    return int(text, 16)


def check_outputs(args: argparse.Namespace) -> None:
    """Find out before the work whether its result can be written, and over nothing that is read.

    Raises UsageError.
    """
    read = (*getattr(args, "log", ()), args.model, args.config, args.memory, *args.dbc, *args.map)
    outputs.check((args.json, args.html, getattr(args, "record", None)), read)


def say(line: str) -> None:
    """Print a line; when nobody reads any more go on without, for the verdict still counts."""
    try:
        print(line, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def add_command(
    commands: Any, name: str, text: str, examples: str, func: Any
) -> argparse.ArgumentParser:
    """Add a subcommand with examples in its help."""
    parser: argparse.ArgumentParser = commands.add_parser(
        name,
        help=text,
        description=text.capitalize() + ".",
        epilog=examples,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(func=func)
    return parser


def add_setup(parser: argparse.ArgumentParser, *, memory: bool = True) -> None:
    """Add model, database, map, settings and fault memory."""
    parser.add_argument("--model", type=Path, help="ONNX model with its card (default: shipped)")
    parser.add_argument("--dbc", type=Path, action="append", default=[], help="CAN database")
    parser.add_argument("--map", type=Path, action="append", default=[], help="its signal map")
    parser.add_argument("--config", type=Path, help="TOML that changes shipped settings")
    if memory:
        parser.add_argument(
            "--memory", type=Path, metavar="FILE", help="fault memory to go on from"
        )


def add_outputs(parser: argparse.ArgumentParser) -> None:
    """Add where results are written."""
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the result as JSON")
    parser.add_argument("--html", type=Path, metavar="OUT", help="write a report")


def add_bus(parser: argparse.ArgumentParser) -> None:
    """Add python-can's bus options."""
    from can.cli import add_bus_arguments

    add_bus_arguments(parser)


def add_obd(parser: argparse.ArgumentParser) -> None:
    """Add the options of polling."""
    parser.add_argument(
        "--obd",
        action="store_true",
        help="ask the engine for OBD-II parameters, 12 requests a second; "
        "without --dbc and --map those of obd2.toml",
    )
    parser.add_argument(
        "--obd-rate", type=positive, metavar="HZ", default=12.0, help="most requests a second"
    )
    parser.add_argument(
        "--obd-request",
        type=hexadecimal,
        metavar="ID",
        help="identifier to ask under, hexadecimal (default: 7E0, 7DF and their 29-bit "
        "counterparts, until one is answered)",
    )


def obd_poller(
    args: argparse.Namespace, bus_map: "BusMap", tell: Callable[[str], None] = say
) -> "ObdPoller":
    """Return what asks for everything the map provides; raises O2Error if there is nothing.

    tell : takes the line about what is supported
    """
    from monitor.bus.polling.answer import Address
    from monitor.bus.polling.pids import lengths, wanted
    from monitor.bus.polling.poller import ADDRESSES, ObdPoller

    parameters = wanted(bus_map, bus_map.names)
    only = args.obd_request
    return ObdPoller(
        parameters,
        lengths(bus_map, parameters),
        addresses=ADDRESSES if only is None else (Address.of(only),),
        rate_hz=args.obd_rate,
        say=tell,
    )


def tell_if_too_slow(args: argparse.Namespace, setup: "Setup", tell: Callable[[str], None]) -> None:
    """Say so if polling cannot bring the signals as often as the model samples them."""
    from monitor.bus.polling.pids import interval_s, wanted

    served_s = interval_s(wanted(setup.bus_map, setup.bus_map.names), args.obd_rate)
    period_s = setup.model.card.period_ns / 1e9
    if served_s > 0.75 * period_s:
        tell(
            f"{setup.model_path.name} samples every {period_s:g} s, polling brings a signal about "
            f"every {served_s:.2g} s: record drives, then o2train fit --period "
            f"{max(0.5, 2 * served_s):.2g}"
        )


def set_up(args: argparse.Namespace) -> "Setup":
    """Load what the options name; raises O2Error for what cannot be used."""
    import dbc
    from monitor.base import config
    from monitor.report import replay

    if len(args.dbc) != len(args.map):
        raise UsageError(
            f"--dbc and --map come in pairs: {len(args.dbc)} --dbc, {len(args.map)} --map"
        )
    pairs = list(zip(args.dbc, args.map, strict=True))
    if getattr(args, "obd", False) and not pairs:
        pairs = [(dbc.path("obd2.dbc"), dbc.path("obd2.toml"))]
    columns = getattr(args, "columns", None)
    return replay.set_up(args.model, pairs, config.load(args.config), columns)


def write_outputs(
    args: argparse.Namespace, setup: "Setup", recordings: list[dict[str, Any]], traces: list[Any]
) -> None:
    """Write JSON and report as asked for; raises UsageError if a file cannot be written."""
    from monitor.report import replay, sinks
    from monitor.report.text import write_report

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
                output=replay.predicted_quantity(setup),
            )
            say(f"report: {args.html}")
    except OSError as error:
        raise UsageError(f"{error.filename}: {error.strerror}") from None


def bus_name(args: argparse.Namespace) -> str:
    """Return interface and channel as given; python-can leaves out what was not."""
    given = (getattr(args, name, None) for name in ("interface", "channel"))
    return " ".join(str(part) for part in given if part)


def open_bus(args: argparse.Namespace) -> "can.BusABC":
    """Open the bus of the options; raises BusError saying why it cannot be."""
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
        where = bus_name(args) or "no -i and -c given"
        cause = error.__cause__ or error
        reason = str(cause) or type(cause).__name__
        raise BusError(f"cannot open the bus ({where}): {reason}") from None
