"""The command ``o2train``."""

import argparse
import os
from collections.abc import Sequence

from monitor.base.command_line import command


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``o2train``; return the exit code."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # two BLAS threads are slower than one here
    return command.run("o2train", lambda _: _parser(), argv, extra="training")


def _parser() -> argparse.ArgumentParser:
    from monitor import __version__
    from training.cli import (
        calibrate,
        check,
        evaluate,
        fit,
        fleet,
        gap,
        recordings,
        simulate,
        study,
        tables,
    )

    parser = argparse.ArgumentParser(
        prog="o2train", description="Recordings, models and limits for the oxygen sensor monitor."
    )
    parser.add_argument("--version", action="version", version=f"o2train {__version__}")
    commands = parser.add_subparsers(
        required=True, metavar="command", dest="command", parser_class=command.Subcommand
    )
    modules = (simulate, recordings, check, fit, evaluate, calibrate, study)
    for module in (*modules, tables, gap, fleet):
        module.add_parsers(commands)
    return parser
