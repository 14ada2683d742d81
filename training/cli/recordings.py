"""The commands ``o2train table`` (log to table) and ``o2train log`` (table to log)."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from monitor.base.command_line import option_paths as paths

if TYPE_CHECKING:
    from collections.abc import Sequence

    from training.recordings.recording import Recording

_TABLE_EXAMPLES = """examples:
  o2train table drive.log --out drive.csv
  o2train table drive.blf --out drive.parquet --dbc my.dbc --map my.toml --period 0.05
  o2train table measurement.mf4 --out drive.csv.gz --columns channels.toml
"""
_LOG_EXAMPLES = """examples:
  o2train log drive.csv --out drive.log
  o2train log drive.parquet --out drive.blf --dbc rusefi.dbc --map rusefi.toml
"""


def add_parsers(subparsers: "argparse._SubParsersAction[Any]") -> None:
    """Add the commands ``table`` and ``log`` to ``subparsers``."""
    _add_table(subparsers)
    _add_log(subparsers)


def _add_table(subparsers: "argparse._SubParsersAction[Any]") -> None:
    table = subparsers.add_parser(
        "table",
        help="write a CAN log or measurement file as a table",
        description="Decode a recording and write it as a table on one sample grid, one column\n"
        "per signal. A cell without a valid value stays blank.",
        epilog=_TABLE_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    table.add_argument("recording", type=paths.read, help="CAN log, table or measurement file")
    table.add_argument(
        "--out", type=paths.written, required=True, help="table to write: .csv, .csv.gz or .parquet"
    )
    add_period_option(table)
    table.add_argument(
        "--signals", nargs="+", metavar="NAME", help="signals to write (default: all)"
    )
    add_bus_options(table)
    table.set_defaults(func=run_table)


def _add_log(subparsers: "argparse._SubParsersAction[Any]") -> None:
    log = subparsers.add_parser(
        "log",
        help="write a table as a CAN log",
        description="Write the frames that an ECU with these signals would send. Every message\n"
        "comes at its cycle time and carries the values of the latest row. A signal that the\n"
        "table lacks is sent as not available.",
        epilog=_LOG_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    log.add_argument("table", type=paths.read, help="table with canonical column names")
    log.add_argument(
        "--out",
        type=paths.written,
        required=True,
        help="log to write: .log, .asc, .blf, .csv, .trc or .mf4; text formats also with .gz",
    )
    log.add_argument(
        "--start",
        type=float,
        metavar="S",
        help="time of the first row in the log in seconds (default: its time in the table)",
    )
    add_bus_options(log)
    log.set_defaults(func=run_log)


FORMATS: Final = (
    "CAN logs (.log .asc .blf .trc .csv .mf4), tables (.csv .parquet), logs of tuning tools (.msl "
    ".mlg .csv) or measurement files (.dat .mdf .mf4); logs and tables of text also with .gz"
)


def add_recordings(parser: argparse.ArgumentParser) -> None:
    """Add the recordings, their period and their bus to a command that reads several."""
    parser.add_argument(
        "recordings",
        nargs="+",
        type=paths.read,
        metavar="RECORDING",
        help=FORMATS,
    )
    add_period_option(parser)
    add_bus_options(parser)


def add_period_option(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--period`` of the sample grid."""
    parser.add_argument(
        "--period",
        type=float,
        metavar="S",
        help="period of the sample grid in seconds (default: 0.1 for logs, the period of the rows "
        "for tables, the period of the model if there is one)",
    )


def add_signal_options(parser: argparse.ArgumentParser) -> None:
    """Add the options ``--inputs`` and ``--output`` of a model."""
    parser.add_argument(
        "--inputs",
        nargs="+",
        metavar="NAME",
        help="input signals of the model (default: the seven inputs of the paper where all "
        "recordings have them, otherwise chosen from what they have)",
    )
    parser.add_argument(
        "--output", metavar="NAME", help="signal that the model predicts (default lambda_measured)"
    )


def add_bus_options(parser: argparse.ArgumentParser) -> None:
    """Add the options ``--dbc``, ``--map`` and ``--profile`` for reading logs and tables."""
    parser.add_argument(
        "--dbc",
        type=paths.read,
        action="append",
        default=[],
        metavar="FILE",
        help="CAN database of the log; repeat it together with --map for several databases "
        "(default: the ECU of this project)",
    )
    parser.add_argument(
        "--map",
        type=paths.read,
        action="append",
        default=[],
        metavar="FILE",
        help="signal map of the preceding --dbc",
    )
    parser.add_argument(
        "--profile",
        "--columns",
        type=paths.read,
        dest="columns",
        metavar="NAME|FILE",
        help="TOML file that says which column of a table or measurement file is which signal, or "
        "a shipped profile's name (default: the profile of a logger's file is recognised)",
    )


def pairs_of(args: argparse.Namespace) -> list[tuple[Path, Path]] | None:
    """Return the pairs of ``--dbc`` and ``--map``, None if there are none.

    Raises UsageError if the numbers of both options differ.
    """
    from monitor.base.errors import UsageError

    if len(args.dbc) != len(args.map):
        raise UsageError(
            f"--dbc is given {len(args.dbc)} times and --map {len(args.map)} times, "
            "pairs are wanted"
        )
    return list(zip(args.dbc, args.map, strict=True)) or None


def load_all(
    args: argparse.Namespace, paths: list[Path], period_s: float | None
) -> "list[Recording]":
    """Return the recordings in ``paths``, read with the bus options of ``args``.

    period_s : sample period of logs and, if set, of tables; None as in ``recording.load``
    Raises RecordingError or UsageError; the message names the file and the reason.
    """
    from monitor.model.step import Model
    from training.api.recordings import load_recordings

    found = load_recordings(
        paths,
        period_s=period_s,
        buses=pairs_of(args),
        columns=args.columns,
        of_model=Model.load(args.model).card.profile if getattr(args, "model", None) else None,
    )
    tell_notes(found)
    return found


def inputs_of(
    args: argparse.Namespace, recordings: "Sequence[Recording]", *, tell: bool = True
) -> tuple[str, ...]:
    """Return the inputs of ``--inputs``, else those chosen from the recordings' signals.

    tell : print the inputs if they are chosen and are not the paper's
    Raises RecordingError if there are none.
    """
    from monitor.base.signals import NARX_INPUTS, OUTPUT
    from training.recordings.samples.input_choice import choose_inputs, in_words

    if args.inputs:
        return tuple(args.inputs)
    chosen = choose_inputs(recordings, args.output or OUTPUT)
    if tell and chosen != NARX_INPUTS:
        print(in_words(chosen))
    return chosen


def tell_notes(recordings: "list[Recording]") -> None:
    """Print how the files of loggers were read."""
    for each in recordings:
        for note in each.notes:
            print(f"o2train: {each.path}: {note}", file=sys.stderr)


def run_table(args: argparse.Namespace) -> int:
    """Write a recording as a table and return exit code 0.

    Raises RecordingError or UsageError (exit code 2).
    """
    from training.recordings.recording import load, write_table

    recording = load(
        args.recording,
        args.signals,
        period_s=args.period,
        pairs=pairs_of(args),
        columns=args.columns,
    )
    tell_notes([recording])
    write_table(args.out, recording.t_s, recording.names, recording.values)
    good = int((recording.quality == 0).sum())
    print(
        f"{args.out}: {len(recording.t_s)} samples of {recording.period_ns / 1e9:g} s, "
        f"{len(recording.names)} signals, {100 * good / max(recording.quality.size, 1):.1f} % good"
    )
    return 0


def run_log(args: argparse.Namespace) -> int:
    """Write a table as a CAN log and return exit code 0.

    Raises RecordingError or UsageError (exit code 2).
    """
    from monitor.base.errors import UsageError
    from monitor.decode.bus_map import load_pairs
    from monitor.frames.candump import LATEST_S
    from monitor.grid.tables import read_table
    from training.recordings.files.can_log import broadcast, write_log
    from training.recordings.recording import check_rows, default_pairs

    if args.start is not None and not 0.0 <= args.start < LATEST_S:
        raise UsageError(f"--start {args.start:g}: seconds from 0 to {LATEST_S:g} are wanted")
    table = read_table(args.table, args.columns)
    check_rows(args.table, table.t_ns)
    bus_map = load_pairs(pairs_of(args) or default_pairs())
    values = {name: table.values[:, i] for i, name in enumerate(table.names)}
    start_ns = None if args.start is None else round(args.start * 1e6) * 1000
    frames = broadcast(bus_map, table.t_ns, values, start_ns)
    write_log(args.out, frames)
    sent = sorted(set(table.names) & set(bus_map.channels))
    lost = sorted(set(bus_map.names) - set(sent))
    print(f"sent {', '.join(sent)}; not available: {', '.join(lost) or 'none'}")
    for name in sorted(set(table.names) & set(bus_map.derived)):
        print(f"o2train: warning: {name} is derived on this bus and not sent", file=sys.stderr)
    seconds = (int(frames.t_ns[-1]) - int(frames.t_ns[0])) / 1e9
    print(f"{args.out}: {len(frames.t_ns)} frames in {seconds:.1f} s")
    return 0
