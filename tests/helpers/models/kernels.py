"""Compile kernels of training and benchmarks, before workers that start together do it each.

python -m tests.helpers.models.kernels
"""

import os
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.studies.second import brick
from training.cli import main as o2train


def main() -> int:
    """Simulate drives, fit both kinds of model to one, make its tables; return the exit code."""
    brick.drive(1, 1, brick.brick(1, 0.2))
    with (
        TemporaryDirectory() as folder,
        Path(os.devnull).open("w") as nowhere,
        redirect_stdout(nowhere),
        redirect_stderr(nowhere),  # that one short drive is not enough
    ):
        o2train(["simulate", "--out", folder, "--format", "csv", "--duration", "200"])
        (drive,) = map(str, Path(folder).glob("*.csv"))
        quick = ["--lags", "2", "--hidden", "2", "--starts", "1", "--budget", "0.01"]
        o2train(["fit", drive, *quick, "--out", f"{folder}/network.onnx"])
        o2train(["fit", drive, "--kind", "greybox", "--out", f"{folder}/chain.onnx"])
        return o2train(["tables", drive, "--out", f"{folder}/tables"])


if __name__ == "__main__":
    sys.exit(main())
