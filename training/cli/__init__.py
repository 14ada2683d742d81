"""The command ``o2train``: one module per subcommand, named after it."""

import argparse
import os
from collections.abc import Sequence
from typing import Final

from monitor.base.command_line import command
from monitor.frames.text.python_can import import_cantools_alone

COMMANDS: Final = {
    "simulate": "simulate drives and write them as logs or tables",
    "table": "write a CAN log or measurement file as a table",
    "log": "write a table as a CAN log",
    "check": "judge before a training whether recordings suffice",
    "fit": "train a model on recordings of a healthy vehicle",
    "evaluate": "predict recordings with a model and report the errors",
    "calibrate": "set a model's decision limits for a false-alarm rate",
    "study": "repeat the whole study of the paper on recordings",
    "tables": "estimate tables for an ECU: lambda delay, wall film, injectors",
    "gap": "find the effect that a model lacks on a healthy vehicle, name it and add it",
    "fleet": "judge all recordings of a fleet, here or on a Dask cluster",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``o2train``; return the exit code."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # two BLAS threads are slower than one here
    import_cantools_alone()  # python-can with all that it finds takes a second, and few need it
    return command.run("o2train", _parser, argv, kinds="monitor.grid.tables", extra="training")


def _parser(arguments: Sequence[str] | None) -> argparse.ArgumentParser:
    text = "Recordings, models and limits for the oxygen sensor monitor."
    return command.parser("o2train", text, "training.cli", COMMANDS, arguments)
