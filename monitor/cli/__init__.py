"""The command ``o2mon``: one module per subcommand, named after it."""

import argparse
import os
from collections.abc import Sequence
from typing import Final

from monitor.base.command_line import command

COMMANDS: Final = {
    "replay": "judge recorded drives",
    "run": "judge a live bus",
    "check": "say which signals are there",
    "doctor": "say what is wrong with a bus, and what to do",
    "inject": "put faults into an engine's frames, or into a log",
    "dtc": "read and clear trouble codes",
    "map": "propose a signal map for a CAN database",
    "export-c": "write the monitor as C for a controller",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``o2mon``; return the exit code."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    return command.run("o2mon", _parser, argv, kinds="monitor.grid.tables")


def _parser(arguments: Sequence[str] | None) -> argparse.ArgumentParser:
    text = "Monitor of the upstream wideband oxygen sensor."
    return command.parser("o2mon", text, "monitor.cli", COMMANDS, arguments)
