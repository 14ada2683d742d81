"""Options, opening of a bus and writing of results, shared by the subcommands of ``o2mon``."""

import argparse
import errno
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from monitor.base.command_line import option_paths as paths
from monitor.base.errors import BusError, UsageError

if TYPE_CHECKING:
    import can

    from monitor.bus.polling.poller import ObdPoller
    from monitor.decode.bus_map import BusMap
    from monitor.pipeline.replay import Setup

NOT_JUDGED = 3


LOGS = (
    "CAN log (.log .asc .blf .trc .csv .mf4), table (.csv .parquet) or log of a tuning tool (.msl "
    ".mlg .csv); logs and tables of text also with .gz"
)


def positive(text: str) -> float:
    """Return the option's value as a positive finite number."""
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text}: a positive number is wanted")
    return value


def hexadecimal(text: str) -> int:
    """Return the option's hexadecimal digits as a whole number."""
    return int(text, 16)


def say(line: str) -> None:
    """Print a line; if the reader is gone, go on silently, because the exit code still counts."""
    try:
        print(line, flush=True)
    except OSError as error:  # a pipe without a reader, or a terminal that hung up
        if error.errno not in (errno.EPIPE, errno.EIO):
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def warn(line: str) -> None:
    """Print a warning that ends nothing."""
    with suppress(BrokenPipeError):
        print(f"o2mon: warning: {line}", file=sys.stderr, flush=True)


def add_columns(parser: argparse.ArgumentParser) -> None:
    """Add the options that give the columns of a table their signals."""
    parser.add_argument(
        "--profile",
        "--columns",
        type=paths.read,
        dest="columns",
        metavar="NAME|FILE",
        help="TOML file that says which column is which signal, or a shipped profile's name "
        "(default: the profile of a logger's file is recognised)",
    )


def add_command(
    commands: Any, name: str, text: str, examples: str, func: Any
) -> argparse.ArgumentParser:
    """Add a subcommand; its help ends with the examples."""
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
    """Add the options of model, database, signal map, settings and fault memory."""
    parser.add_argument(
        "--model", type=paths.read, help="ONNX model with its card (default: shipped)"
    )
    parser.add_argument(
        "--dbc",
        type=paths.read,
        action="append",
        default=[],
        help="CAN database (.dbc); repeat it with --map for several databases (default: the "
        "project's own ECU)",
    )
    parser.add_argument(
        "--map",
        type=paths.read,
        action="append",
        default=[],
        help="signal map (.toml) of the --dbc before it; repeat it with --dbc",
    )
    parser.add_argument(
        "--config", type=paths.read, help="TOML file that changes the shipped settings"
    )
    if memory:
        parser.add_argument(
            "--memory",
            type=paths.kept,
            metavar="FILE",
            help="fault memory to continue, or to create; its copy is FILE.b; clear with o2mon dtc",
        )


def add_outputs(parser: argparse.ArgumentParser) -> None:
    """Add the options of the result files."""
    parser.add_argument(
        "--json", type=paths.written, metavar="OUT", help="write the result as JSON"
    )
    parser.add_argument(
        "--html", type=paths.written, metavar="OUT", help="write the result as a web page"
    )


def add_bus(parser: argparse.ArgumentParser) -> None:
    """Add python-can's bus options."""
    from can.cli import add_bus_arguments

    add_bus_arguments(parser)


def add_obd(parser: argparse.ArgumentParser) -> None:
    """Add the options of OBD-II polling."""
    parser.add_argument(
        "--obd",
        action="store_true",
        help="poll OBD-II parameters from the engine; the default of --dbc and --map is then "
        "the shipped obd2.dbc with obd2.toml",
    )
    parser.add_argument(
        "--obd-rate",
        type=positive,
        metavar="HZ",
        default=12.0,
        help="most requests per second (default: 12)",
    )
    parser.add_argument(
        "--obd-optional",
        action="store_true",
        help="ask for the map's optional signals, too: the sensor behind the catalyst and the "
        "catalyst's temperature",
    )
    parser.add_argument(
        "--obd-request",
        type=hexadecimal,
        metavar="ID",
        help="identifier of the requests, hexadecimal (default: 7E0, 7DF and their 29-bit "
        "counterparts in turn, until one is answered)",
    )


def obd_poller(
    args: argparse.Namespace, bus_map: "BusMap", tell: Callable[[str], None] = say
) -> "ObdPoller":
    """Return a poller for every OBD-II parameter of the map.

    tell : receives a line about the supported parameters
    Raises O2Error if the map has no OBD-II parameter.
    """
    from monitor.bus.polling.answer import EcuAddress
    from monitor.bus.polling.pids import lengths, wanted
    from monitor.bus.polling.poller import ADDRESSES, ObdPoller

    parameters = wanted(bus_map, _asked_names(args, bus_map))
    only = args.obd_request
    return ObdPoller(
        parameters,
        lengths(bus_map, parameters),
        addresses=ADDRESSES if only is None else (EcuAddress.of(only),),
        rate_hz=args.obd_rate,
        say=tell,
    )


def _asked_names(args: argparse.Namespace, bus_map: "BusMap") -> tuple[str, ...]:
    return (*bus_map.names, *bus_map.optional) if args.obd_optional else bus_map.names


def tell_if_too_slow(args: argparse.Namespace, setup: "Setup", tell: Callable[[str], None]) -> None:
    """Tell the user if polling brings signals less often than the model samples them."""
    from monitor.bus.polling.pids import interval_s, wanted

    names = _asked_names(args, setup.bus_map)
    served_s = interval_s(wanted(setup.bus_map, names), args.obd_rate)
    period_s = setup.model.card.period_ns / 1e9
    if served_s > 0.75 * period_s:
        tell(
            f"{setup.model_path.name} samples every {period_s:g} s, polling brings a signal about "
            f"every {served_s:.2g} s: record drives, then o2train fit --period "
            f"{max(0.5, 2 * served_s):.2g}"
        )


def set_up(args: argparse.Namespace, *, judges: bool = True) -> "Setup":
    """Load the files of the options; raises O2Error if one is unusable.

    judges : whether the model must have decision limits
    """
    import dbc
    from monitor.base import config
    from monitor.pipeline import replay

    if len(args.dbc) != len(args.map):
        raise UsageError(
            f"--dbc and --map come in pairs: {len(args.dbc)} --dbc, {len(args.map)} --map"
        )
    pairs = list(zip(args.dbc, args.map, strict=True))
    if getattr(args, "obd", False) and not pairs:
        pairs = [(dbc.path("obd2.dbc"), dbc.path("obd2.toml"))]
    columns = getattr(args, "columns", None)
    return replay.set_up(args.model, pairs, config.load(args.config), columns, judges=judges)


def write_outputs(
    args: argparse.Namespace, setup: "Setup", recordings: list[dict[str, Any]], traces: list[Any]
) -> None:
    """Write the JSON and HTML that the options name; raises UsageError if that fails."""
    from monitor.base.files.json_text import write_json
    from monitor.pipeline.replay import result_of
    from monitor.report.model_facts import model_info, predicted_quantity
    from monitor.report.page import write_report

    result = result_of(recordings, setup)
    if args.json:
        write_json(args.json, result)
    if args.html:
        write_report(
            args.html,
            result,
            traces,
            title="Oxygen sensor monitor",
            model_info=model_info(setup),
            output=predicted_quantity(setup),
        )
        say(f"report: {args.html}")


def bus_name(args: argparse.Namespace) -> str:
    """Return interface and channel of the options, without those that are left out."""
    parts = (getattr(args, name, None) for name in ("interface", "channel"))
    return " ".join(str(part) for part in parts if part)


def open_bus(args: argparse.Namespace) -> "can.BusABC":
    """Open the bus of the options; raises BusError with the reason if it fails."""
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
