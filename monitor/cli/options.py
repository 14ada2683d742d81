"""Options, opening of a bus and writing of results, shared by the subcommands of ``o2mon``."""

import argparse
import errno
import logging
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO

from monitor.base.command_line import option_paths as paths
from monitor.base.command_line.option_kinds import BUS, ActsOn
from monitor.base.command_line.parameters import OF_FRAMES, BusFiles, Input, Output, SettingsFile
from monitor.base.counts import plain
from monitor.base.errors import BusError, RecordingError, SignalMapError, UsageError

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


def add_bus(parser: argparse.ArgumentParser, **side: Any) -> None:
    """Add python-can's bus options.

    side : keywords of ``can.cli.add_bus_arguments``
    """
    from monitor.frames.text.python_can import import_without_mdf

    import_without_mdf()
    from can.cli import add_bus_arguments

    n_before = len(parser._actions)
    add_bus_arguments(parser, **side)
    for action in parser._actions[n_before:]:
        (OF_FRAMES if action.dest == "channel" else ActsOn([BUS])).mark(action)


Bus = Annotated[argparse.Namespace, add_bus]
Seconds = Annotated[float, positive, "S"]
Hertz = Annotated[float, positive, "HZ"]


@dataclass(frozen=True, kw_only=True)
class SetupOptions(BusFiles, SettingsFile):
    """Model, database, signal map and settings.

    model : ONNX model with its card (default: shipped)
    """

    model: Input | None = None


@dataclass(frozen=True, kw_only=True)
class JudgeOptions(SetupOptions):
    """What a judgement needs and writes.

    memory : fault memory to continue, or to create; its copy is FILE.b; clear with o2mon dtc
    json : write the result as JSON
    html : write the result as a web page
    """

    memory: Annotated[Path | None, paths.kept, "FILE"] = None
    json: Output = None
    html: Output = None


@dataclass(frozen=True, kw_only=True)
class ObdOptions:
    """Polling of OBD-II.

    obd : poll OBD-II parameters from the engine; the default of --dbc and --map is then the shipped
        obd2.dbc with obd2.toml
    obd_rate : most requests per second
    obd_optional : ask for the map's optional signals, too: the sensor behind the catalyst and the
        catalyst's temperature
    obd_request : identifier of the requests, hexadecimal (default: 7E0, 7DF and their 29-bit
        counterparts in turn, until one is answered)
    """

    obd: Annotated[bool, OF_FRAMES] = False
    obd_rate: Annotated[Hertz, ActsOn([BUS])] = 12.0
    obd_optional: Annotated[bool, ActsOn([BUS])] = False
    obd_request: Annotated[int | None, hexadecimal, ActsOn([BUS]), "ID"] = None

    def __post_init__(self) -> None:
        """Raise UsageError for options without effect."""
        if not self.obd and any((self.obd_rate != 12, self.obd_optional, self.obd_request)):
            raise UsageError("--obd-rate, --obd-optional and --obd-request need --obd")


def say(line: str, stream: TextIO | None = None) -> None:
    """Print a line; if the reader is gone, go on silently, because the exit code still counts."""
    stream = stream or sys.stdout
    try:
        print(line, file=stream, flush=True)
    except OSError as error:  # a pipe without a reader, or a terminal that hung up
        if error.errno not in (errno.EPIPE, errno.EIO):
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def warn(line: str) -> None:
    """Print a warning that ends nothing."""
    with suppress(BrokenPipeError):
        print(f"o2mon: warning: {line}", file=sys.stderr, flush=True)


class Unusable(dict[str, str]):
    """The logs that cannot be used, with their errors: the others go on without them."""

    @contextmanager
    def set_aside(self, log: Path) -> Iterator[None]:
        """Keep the error of a log that cannot be used."""
        try:
            yield
        except (RecordingError, SignalMapError) as error:
            self[str(log)] = str(error)

    def end(self) -> None:
        """Say the errors; the last one, if any, is raised as UsageError."""
        *others, last = self.values() or [""]
        for line in others:
            warn(line)
        if last:
            raise UsageError(last)


def obd_poller(
    args: ObdOptions, bus_map: "BusMap", tell: Callable[[str], None] = say
) -> "ObdPoller":
    """Return a poller for every OBD-II parameter of the map.

    tell : receives a line about the supported parameters
    Raises O2Error if the map has no OBD-II parameter.
    """
    from monitor.bus.polling.answer import EcuAddress
    from monitor.bus.polling.pids import wanted
    from monitor.bus.polling.poller import ADDRESSES, ObdPoller

    only = args.obd_request
    names = (*bus_map.names, *bus_map.optional) if args.obd_optional else bus_map.names
    return ObdPoller(
        wanted(bus_map, names),
        addresses=ADDRESSES if only is None else (EcuAddress.of(only),),
        rate_hz=args.obd_rate,
        say=tell,
    )


def tell_if_too_slow(poller: "ObdPoller", setup: "Setup", tell: Callable[[str], None]) -> None:
    """Tell the user if polling brings signals less often than the model samples them."""
    served_s, period_s = poller.interval_s, setup.model.card.period_ns / 1e9
    if served_s > 0.75 * period_s:
        tell(
            f"{setup.model.path.name} samples every {period_s:g} s, polling brings a signal about "
            f"every {plain(served_s, 2)} s: record drives, then o2train fit --period "
            f"{plain(max(0.5, 2 * served_s), 2)}"
        )


def set_up(
    args: SetupOptions, columns: Path | None = None, *, obd: bool = False, judges: bool = True
) -> "Setup":
    """Load the files of the options; raises O2Error if one is unusable.

    Beside a LOG, the channel of the options is that of a log that holds several buses.

    obd : whether the default of database and map is that of OBD-II
    judges : whether the model must have decision limits
    """
    import dbc
    from monitor.base import config
    from monitor.pipeline import replay

    pairs = args.pairs
    if obd and not pairs:
        pairs = [(dbc.path("obd2.dbc"), dbc.path("obd2.toml"))]
    loaded = config.load(args.config)
    named = args if hasattr(args, "channel") else getattr(args, "bus", None)
    channel = getattr(named, "channel", None) if getattr(args, "log", None) else None
    return replay.set_up(args.model, pairs, loaded, columns, judges=judges, channel=channel or "")


def write_outputs(
    args: JudgeOptions,
    setup: "Setup",
    recordings: list[dict[str, Any]],
    traces: list[Any],
    steps: Mapping[str, str] | None = None,
    stream: TextIO | None = None,
) -> None:
    """Write the JSON and HTML that the options name; raises UsageError if that fails.

    stream : where the page is named, by default stdout
    steps : commands that led to the result, with their output
    """
    from monitor.base.files.json_text import write_json
    from monitor.pipeline.replay import result_of
    from monitor.report.model_facts import model_info, predicted_quantity
    from monitor.report.page import write_report

    result = result_of(recordings, setup)
    if args.json:
        write_json(args.json, result)
    if args.html:
        info, output = model_info(setup), predicted_quantity(setup)
        write_report(args.html, result, traces, model_info=info, output=output, steps=steps)
        say(f"report: {args.html}", stream)


def bus_address(args: argparse.Namespace) -> tuple[str, str]:
    """Return interface and channel of the options, else of the environment or can.conf, else ""."""
    from can.util import load_config

    given = {n: getattr(args, n) for n in ("interface", "channel") if getattr(args, n, None)}
    try:
        config = dict(load_config(config=given))
    except Exception:  # python-can raises errors of several kinds where nothing is configured
        config = given
    interface, channel = (config.get(name) for name in ("interface", "channel"))
    return interface or "", "" if channel is None else str(channel)


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
        where = " ".join(bus_address(args)).strip() or "no -i and -c given"
        cause: BaseException = error
        while cause.__cause__:
            cause = cause.__cause__
        reason = str(cause) or type(cause).__name__
        if "msgpack" in reason:
            reason += ": pip install '.[multicast]' in the project's folder"
        if "udp_multicast" in where and getattr(cause, "errno", None) == errno.ENODEV:
            reason += ": it needs a network, and here is none (a container's --network none?)"
        logging.getLogger("can.bus").setLevel(logging.CRITICAL)  # "not properly shut down"
        raise BusError(f"cannot open the bus ({where}): {reason}") from None
