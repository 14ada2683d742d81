"""The command ``o2mon``: one module per subcommand, named after it."""

import argparse
import os
from collections.abc import Sequence

from monitor.base.command_line.command import Subcommand
from monitor.base.command_line.command import run as run_command


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``o2mon``; return the exit code."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    return run_command("o2mon", _parser, argv)


def _parser(arguments: Sequence[str] | None) -> argparse.ArgumentParser:
    """Return the parser; only the command of the arguments has its options, with None every one.

    The options of a bus come from python-can, whose import takes longer than all the rest.
    """
    from monitor import __version__
    from monitor.cli import check, dtc, inject, replay, run
    from monitor.cli import map as map_

    parser = argparse.ArgumentParser(
        prog="o2mon", description="Monitor of the upstream wideband oxygen sensor."
    )
    parser.add_argument("--version", action="version", version=f"o2mon {__version__}")
    commands = parser.add_subparsers(
        required=True, metavar="command", dest="command", parser_class=Subcommand
    )
    named = next((word for word in arguments or () if not word.startswith("-")), None)
    for name, command in {
        "replay": replay,
        "run": run,
        "check": check,
        "inject": inject,
        "dtc": dtc,
        "map": map_,
    }.items():
        if arguments is None or name == named:
            command.add(commands)
        else:
            commands.add_parser(name, help=command.HELP)
    return parser
