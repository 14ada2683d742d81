"""The option ``--seed`` of the commands that train networks."""

import argparse

from monitor.base.errors import UsageError


def add_seed_option(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--seed``."""
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        metavar="N",
        help="seed of the initial weights and of the held-out blocks (default 0)",
    )


def check_seed(args: argparse.Namespace) -> None:
    """Raise UsageError if the seed is negative."""
    if args.seed < 0:
        raise UsageError("--seed is at least 0")
