"""The command ``o2train check``: judge before a training whether recordings suffice."""

import argparse
import json
from typing import TYPE_CHECKING, Any

from monitor.base.command_line import option_paths as paths
from training.cli.recordings import (
    FORMATS,
    add_bus_options,
    add_period_option,
    add_signal_options,
    inputs_of,
    load_all,
)

if TYPE_CHECKING:
    from training.recordings.recording import Recording

_EXAMPLES = """examples:
  o2train check drive1.log drive2.log drive3.log
  o2train check run_*.csv.gz --inputs speed_z load_z ignition_angle_z fuel_cutoff_z \\
      --output lambda_z --html check.html

Every finding is ok, a warning or an error. Exit code 0: no errors, the recordings can be used.
Exit code 2: at least one error, the recordings cannot be used."""


def add_parsers(subparsers: "argparse._SubParsersAction[Any]") -> None:
    """Add the command ``check`` to ``subparsers``."""
    check = subparsers.add_parser(
        "check",
        help="judge before a training whether recordings suffice",
        description="Judge whether recordings suffice to train a model. The command checks\n"
        "duration, coverage of speed and load, excitation of every input, time in closed loop,\n"
        "missing channels, gaps, inputs that copy the output, and collinear inputs.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    check.add_argument(
        "recordings",
        nargs="+",
        type=paths.read,
        metavar="RECORDING",
        help=FORMATS,
    )
    add_signal_options(check)
    check.add_argument(
        "--lags",
        type=int,
        default=5,
        metavar="N",
        help="longest lag of the planned model in samples (default 5)",
    )
    check.add_argument(
        "--hidden",
        type=int,
        nargs="+",
        default=[8, 8],
        metavar="N",
        help="neurons per hidden layer of the planned model (default 8 8)",
    )
    add_period_option(check)
    add_bus_options(check)
    check.add_argument(
        "--json", type=paths.written, metavar="OUT", help="write findings and figures as JSON"
    )
    check.add_argument("--html", type=paths.written, metavar="OUT", help="write an HTML report")
    check.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Print the findings, write the reports and return exit code 0.

    Raises RecordingError if the recordings cannot be used, UsageError for an impossible option
    (both exit code 2).
    """
    from monitor.base.errors import RecordingError, UsageError
    from monitor.base.files.outputs import write_text
    from monitor.base.signals import NARX_INPUTS, OUTPUT
    from training.limits.data_check.check import check
    from training.limits.data_check.findings import as_page, as_text, verdict

    if min(args.lags, *args.hidden) < 1:
        raise UsageError("--lags and --hidden must be positive")
    recordings, unreadable = _load(args)
    inputs = inputs_of(args, recordings) if recordings else (args.inputs or NARX_INPUTS)
    result = check(
        recordings,
        inputs,
        args.output or OUTPUT,
        lags=args.lags,
        hidden=args.hidden,
        unreadable=unreadable,
    )
    print(as_text(result))
    if args.json:
        write_text(args.json, json.dumps(result, indent=1, allow_nan=False) + "\n")
    if args.html:
        write_text(args.html, as_page(result))
    if not result["usable"]:
        first = next(f["text"] for f in result["findings"] if f["level"] == "error")
        raise RecordingError(f"{verdict(result)}; the first: {first}")
    return 0


def _load(args: argparse.Namespace) -> tuple["list[Recording]", list[str]]:
    """Return the readable recordings, and one error message per unreadable file."""
    from monitor.base.errors import RecordingError

    recordings: list[Recording] = []
    unreadable: list[str] = []
    for path in args.recordings:
        try:
            recordings += load_all(args, [path], args.period)
        except RecordingError as error:
            unreadable.append(str(error))
        except OSError as error:
            unreadable.append(f"{path}: {error.strerror or error}")
    return recordings, unreadable
