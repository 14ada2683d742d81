"""Free run of a model on drives that its training did not use, compared with a first model.

The training vehicle and ten others drive a WLTC each; all drives are simulated. Figures are for
the enabled samples.

python -m benchmarks free_run [--model MODEL] [--vehicles 11]
"""

import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.outcome import BenchmarkOptions, Row, finish
from benchmarks.verdicts.physical_baseline import fit_baseline
from monitor.base import config
from monitor.judge.limits import Limits
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment
from training.limits.judging import judge_recordings
from training.recordings import metrics
from training.recordings.recording import Recording, load

TRAINING = (("wltc_3b", 1001), ("udds", 1002), ("us06", 1003))  # the baseline is fitted on these
TEST_SEED = 2001


def simulated(folder: Path, **what: object) -> Recording:
    """Return one simulated drive."""
    return load(write(Experiment(**what), folder, "parquet"))


def figures(measured: np.ndarray, predicted: np.ndarray) -> dict[str, float]:
    """Return the figures on lambda."""
    found = metrics.measures(measured, predicted)
    names = {"r": "correlation", "RMSE": "rmse", "slope": "slope", "mean error": "residual_mean"}
    return {title: found[name] for title, name in names.items()}


def main(argv: Sequence[str]) -> int:
    """Compare both models on each vehicle."""
    options = BenchmarkOptions(__name__, __doc__, vehicles=1, seconds=300.0)
    options.add_argument("--model", type=Path, default=shipped_model())
    options.add_argument("--vehicles", type=int, default=11)
    options.add_argument("--seconds", type=float, help="of each drive; by default all")
    args = options.parse_args(argv)
    model, settings, rows = Model.load(args.model), config.load(), list[Row]()
    limits = Limits.from_card(model.card, settings, str(args.model))
    with tempfile.TemporaryDirectory() as name:
        drive = partial(simulated, Path(name), duration_s=args.seconds)
        baseline = fit_baseline([drive(cycle=c, seed=s) for c, s in TRAINING])
        for vehicle in range(1, args.vehicles + 1):
            recording = drive(vehicle=vehicle, seed=TEST_SEED + vehicle - 1)
            judged = judge_recordings([recording], model, limits, settings)[0]
            on, first = judged.enabled, 1.0 / baseline.predict(recording)
            for which, predicted in (("shipped", judged.predicted), ("baseline", first)):
                told = figures(recording.column(model.card.output.name)[on], predicted[on])
                rows.append({"vehicle": vehicle, "model": which} | told)
    return finish(args, rows)
