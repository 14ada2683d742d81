"""Train a network on your own tables and compare its free run with ARX on a drive left out.

    python examples/train_and_compare.py train1.csv train2.csv … test.csv

The last table is left out. Without tables, three drives of a simulated vehicle serve.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from monitor.base.types import FloatArray
from training import evaluate, fit, load_recordings
from training.cli import main as o2train
from training.recordings.recording import Recording

ORDER = 5  # past samples of inputs and output that ARX reads


def simulated(folder: Path) -> list[Path]:
    """Drive a simulated vehicle three times and return the tables."""
    for seed in (1, 2, 3):
        options = ["--cycle", "micro_trips", "--seed", str(seed), "--format", "csv"]
        o2train(["simulate", "--out", str(folder), *options])
    return sorted(folder.glob("*.csv"))


def signals(recording: Recording, inputs: list[str], output: str) -> tuple[FloatArray, FloatArray]:
    """Return inputs (n, n_inputs) and 1/output (n,) with the last good value in every gap."""
    columns = []
    for name in (*inputs, output):
        column = recording.column(name).copy()
        last = np.maximum.accumulate(np.where(np.isfinite(column), np.arange(len(column)), 0))
        column = column[last]
        columns.append(np.where(np.isfinite(column), column, np.nanmedian(column)))
    return np.column_stack(columns[:-1]), 1.0 / columns[-1]


def regressors(u: FloatArray, y: FloatArray, t: int) -> FloatArray:
    """Return what ARX reads at sample t."""
    return np.concatenate([y[t - ORDER : t], u[t - ORDER : t].ravel(), [1.0]])


def arx_free_run(train: list[tuple[FloatArray, FloatArray]], u: FloatArray, y: FloatArray) -> float:
    """Return the error of ARX in free run, as root mean square of 1/lambda."""
    rows = [(regressors(a, b, t), b[t]) for a, b in train for t in range(ORDER, len(b))]
    read, wanted = (np.array(column) for column in zip(*rows, strict=True))
    weights = np.linalg.lstsq(read, wanted, rcond=None)[0]
    free = y.copy()
    for t in range(ORDER, len(y)):
        free[t] = np.clip(regressors(u, free, t) @ weights, 0.0, 1.7)
    return float(np.sqrt(np.mean((free - y)[ORDER:] ** 2)))


def main(tables: list[Path]) -> None:
    """Train, evaluate on the last table, print both errors."""
    with tempfile.TemporaryDirectory() as folder:
        files = tables or simulated(Path(folder))
        *train, test = load_recordings(files)
        model = Path(folder) / "model.onnx"
        fitted = fit(train, model, lags=5, hidden=(8, 8), starts=2, budget_minutes=1.0)
        inputs, output = list(fitted.card.input_names), fitted.card.output.name
        figures = evaluate(model, test).recordings[0]
        arx = arx_free_run(
            [signals(each, inputs, output) for each in train], *signals(test, inputs, output)
        )
        print(
            f"left out: {test.path.name}, {figures['samples']} samples, free run, RMSE in 1/lambda"
        )
        error, held_out = figures["rmse_phi"], fitted.card.fit["test"]["correlation"]
        print(f"  network  {error:.4f}   (correlation {held_out:.3f} on held-out blocks)")
        print(f"  ARX({ORDER})   {arx:.4f}")


if __name__ == "__main__":
    main([Path(argument) for argument in sys.argv[1:]])
