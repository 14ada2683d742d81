"""Options that choose where jobs run: on this machine's cores or on a Dask cluster."""

import argparse
import os

from monitor.base.errors import UsageError


def add_cores_options(parser: "argparse._ActionsContainer") -> None:
    """Add ``--jobs`` and ``--scheduler``."""
    parser.add_argument(
        "--jobs", type=int, metavar="N", help="processes on this machine (default: one per core)"
    )
    parser.add_argument(
        "--scheduler",
        metavar="URL",
        help="Dask scheduler to use instead, for example tcp://host:8786",
    )


def jobs_of(args: argparse.Namespace) -> int:
    """Return the number of processes; raises UsageError if it is less than one."""
    if args.jobs is not None and args.jobs < 1:
        raise UsageError(f"--jobs is at least 1, not {args.jobs}")
    return args.jobs or os.cpu_count() or 1
