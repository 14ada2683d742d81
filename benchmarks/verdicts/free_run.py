"""Free run of a model on drives that its training did not use, compared with a first model.

The training vehicle and ten others drive a WLTC each; all drives are simulated. Figures are for
the enabled samples.

    python -m benchmarks free_run [--model MODEL]
"""

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from monitor.base import config
from monitor.judge.limits import Limits
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.physical_baseline import Baseline, fit_baseline
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment
from training.limits.judging import judge
from training.recordings import metrics
from training.recordings.recording import Recording, load

TRAINING = (("wltc_3b", 1001), ("udds", 1002), ("us06", 1003))  # the baseline is fitted on these
TEST_SEED = 2001


def simulated(folder: Path, **what: object) -> Recording:
    """Return one simulated drive."""
    return load(write(Experiment(**what), folder, "parquet"))  # type: ignore[arg-type]


def figures(measured: np.ndarray, predicted: np.ndarray) -> str:
    """Return the line of figures on lambda."""
    return (
        f"r {metrics.correlation(measured, predicted):.4f}  "
        f"RMSE {metrics.rmse(measured, predicted):.4f}  "
        f"slope {metrics.slope(measured, predicted):.3f}  "
        f"mean {float((measured - predicted).mean()):+.4f}"
    )


def line(recording: Recording, path: Path, baseline: Baseline) -> str:
    """Return both models' figures on one drive."""
    model = Model.load(path)
    judged = judge(
        recording, model, Limits.from_card(model.card, config.load(), str(path)), config.load()
    )
    on = judged.enabled
    first = 1.0 / baseline.predict(recording)
    return (
        f"NARX {figures(judged.measured[on], judged.predicted[on])} | "
        f"baseline {figures(judged.measured[on], first[on])}"
    )


def main(argv: Sequence[str]) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", type=Path, default=shipped_model())
    path = parser.parse_args(argv).model
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        baseline = fit_baseline([simulated(folder, cycle=c, seed=s) for c, s in TRAINING])
        print(f"baseline: {baseline}")
        for vehicle in range(1, 12):
            drive = simulated(folder, vehicle=vehicle, seed=TEST_SEED + vehicle - 1)
            print(
                f"simulated WLTC, vehicle {vehicle:2d}: {line(drive, path, baseline)}", flush=True
            )
    print(f"contraction: {Model.load(path).card.checks['contraction']}")
    return 0
