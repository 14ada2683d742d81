"""Options that choose where jobs run: on the cores of this machine or on a Dask cluster."""

import argparse
import os

from monitor.base.errors import UsageError


def add_cores_options(parser: "argparse._ActionsContainer") -> None:
    """Add the options ``--jobs`` and ``--scheduler``."""
    parser.add_argument(
        "--jobs",
        type=int,
        metavar="N",
        help="number of processes on this machine (default: one per core)",
    )
    parser.add_argument(
        "--scheduler",
        metavar="URL",
        help="run the jobs on the Dask cluster of this scheduler, for example tcp://host:8786",
    )


def jobs_of(args: argparse.Namespace) -> int:
    """Return the number of processes of ``--jobs``, by default one per core.

    Raises UsageError if the number is below 1.
    """
    if args.jobs is not None and args.jobs < 1:
        raise UsageError(f"--jobs is at least 1, not {args.jobs}")
    return args.jobs or os.cpu_count() or 1
