"""Real measurements: lambda on the Bosch engine recordings, and faults put on afterwards.

Training on runs 10 to 15 and 30 to 33, test on 53 and 54; 10 Hz, all channels z-scored by their
authors (boschresearch/Bosch-Engine-Datasets, CC BY-SA 4.0). The faults are put onto the measured
lambda, so the control loop did not see them. ``--mask`` maps the fuel cut-off to the enable
conditions, so that windows exclude fuel cut and its recovery.

    python benchmarks/bosch.py FOLDER [--model MODEL] [--budget MINUTES] [--mask]
"""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from monitor import config
from monitor.limits import Limits
from monitor.model import Model
from training import cli, metrics
from training.judge import judge
from training.recordings import Recording, load

INPUTS = ("speed_z", "load_z", "ignition_angle_z", "fuel_cutoff_z")
OUTPUT = "lambda_z"
TRAINING = (10, 11, 12, 13, 14, 15, 30, 31, 32, 33)
TEST = (53, 54)
# z = -0.11644 is no cut; the channel is binary, so z * std + mean = 0 or 1
MASK = """
time_s = "time_s"
speed_z = "speed_z"
load_z = "load_z"
ignition_angle_z = "ignition_angle_z"
fuel_cutoff_z = "fuel_cutoff_z"
lambda_z = "lambda_z"
fuel_cut = { column = "fuel_cutoff_z", factor = 0.11365, offset = 0.0132335 }
"""


def lagged(values: np.ndarray, tau_s: float, period_s: float) -> np.ndarray:
    """Return the signal behind a first-order lag."""
    keep = np.exp(-period_s / tau_s)
    out, _ = lfilter([1.0 - keep], [1.0, -keep], values, zi=[keep * values[0]])
    return np.asarray(out)


def delayed(values: np.ndarray, delay_s: float, period_s: float) -> np.ndarray:
    """Return the signal after a dead time."""
    steps = round(delay_s / period_s)
    return np.concatenate([np.full(steps, values[0]), values[:-steps]])


def with_output(recording: Recording, values: np.ndarray) -> Recording:
    """Return the recording with another measured lambda."""
    changed = recording.values.copy()
    changed[:, recording.names.index(OUTPUT)] = values
    return replace(recording, values=changed)


def report(title: str, recording: Recording, path: Path) -> None:
    """Print what the monitor makes of one recording."""
    model = Model.load(path)
    limits = Limits.from_card(model.card, config.load(), str(path))
    judged = judge(recording, model, limits, config.load())
    windows = judged.windows
    count = {o: sum(w.outcome == o for w in windows) for o in ("passed", "failed", "inconclusive")}
    measured, predicted = judged.measured, judged.predicted
    on = judged.enabled & np.isfinite(predicted)
    names = sorted({f"{d.code} {d.fault}" for d in judged.dtcs})
    print(
        f"{title:34s} enabled fit {metrics.fit_percent(measured[on], predicted[on]):5.1f} %, "
        f"max |prediction| {np.nanmax(np.abs(predicted)):.2f} z; windows {len(windows)}: "
        f"mean {np.mean([w.mean for w in windows]):+.3f}, "
        f"std of means {np.std([w.mean for w in windows]):.3f}, "
        f"median std {np.median([w.std for w in windows]):.3f}; {count}; "
        f"paper's rule {sum(w.paper_failed for w in windows)}; codes {names or 'none'}"
    )


def main() -> None:
    """Fit unless a model is given, then judge the test runs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--model", type=Path)
    parser.add_argument("--budget", default="10")
    parser.add_argument("--mask", action="store_true")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        columns = Path(name) / "columns.toml"
        columns.write_text(MASK)
        mask = ["--columns", str(columns)] if args.mask else []
        path = args.model or Path(name) / "bosch.onnx"
        if not args.model:
            runs = [str(args.folder / f"run_{n:06d}.csv.gz") for n in TRAINING]
            names = ["--inputs", *INPUTS, "--output", OUTPUT, "--budget", args.budget]
            cli.main(["fit", *runs, *mask, *names, "--out", str(path)])
        for run in TEST:
            recording = load(
                args.folder / f"run_{run:06d}.csv.gz", columns=columns if args.mask else None
            )
            period_s = recording.period_ns / 1e9
            healthy = recording.column(OUTPUT)
            report(f"run {run}, healthy", recording, path)
            late = with_output(recording, delayed(healthy, 0.4, period_s))
            report(f"run {run}, delay 0.4 s afterwards", late, path)
            slow = with_output(recording, lagged(healthy, 0.6, period_s))
            report(f"run {run}, lag 0.6 s afterwards", slow, path)


if __name__ == "__main__":
    main()
