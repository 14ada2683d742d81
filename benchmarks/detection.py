"""Verdicts on simulated drives: healthy ones of many seeds, and every fault at its usual severity.

No seed here was used for training or to choose anything. Half of the healthy drives are of the
training vehicle, the others and the faulty ones of vehicles that were used for nothing else.

    python benchmarks/detection.py [--model MODEL] [--healthy 24] [--jobs 2]
"""

import argparse
import tempfile
from collections import Counter
from pathlib import Path

from joblib import Parallel, delayed

from monitor import config, faults
from monitor.limits import Limits
from monitor.model import Model
from monitor.replay import shipped_model
from training.dyno.simulate import Experiment
from training.dyno.write import write
from training.judge import judge
from training.recordings import load

HEALTHY_SEED, FAULTY_SEED = 30_000, 40_000
VEHICLES_PER_FAULT = 3
ON_THE_BUS = ("out_of_range", "signal_missing")


def verdict(experiment: Experiment, path: Path) -> tuple[Experiment, str, bool, float, float]:
    """Return names found, whether the test completed, the share of windows of the paper's rule."""
    model = Model.load(path)
    with tempfile.TemporaryDirectory() as folder:
        # a table cannot say why a value is not there
        suffix = "log" if experiment.fault and experiment.fault.name in ON_THE_BUS else "parquet"
        recording = load(write(experiment, Path(folder), suffix))
    judged = judge(
        recording, model, Limits.from_card(model.card, config.load(), str(path)), config.load()
    )
    names = ", ".join(sorted({d.fault for d in judged.dtcs})) or "-"
    windows = len(judged.windows)
    paper = sum(w.paper_failed for w in judged.windows) / windows if windows else 0.0
    first_s = min((d.t_ns / 1e9 for d in judged.dtcs), default=float("nan"))
    return experiment, names, judged.completed, paper, first_s


def experiments(n_healthy: int) -> list[Experiment]:
    """Return the drives: one WLTC each."""
    healthy = [
        Experiment(vehicle=1 if i % 2 else 300 + i, seed=HEALTHY_SEED + i) for i in range(n_healthy)
    ]
    faulty = [
        Experiment(vehicle=400 + i, seed=FAULTY_SEED + 100 * k + i, fault=faults.resolve(name))
        for k, name in enumerate(faults.NAMES)
        for i in range(VEHICLES_PER_FAULT)
    ]
    return healthy + faulty


def main() -> None:
    """Print one line a drive and the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", type=Path, default=shipped_model())
    parser.add_argument("--healthy", type=int, default=24)
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    jobs = (delayed(verdict)(e, args.model) for e in experiments(args.healthy))
    counts: Counter[str] = Counter()
    for experiment, names, completed, paper, first_s in Parallel(args.jobs, return_as="generator")(
        jobs
    ):
        wanted = experiment.fault.name if experiment.fault else "-"
        kind = "healthy" if wanted == "-" else "faulty"
        counts[kind] += 1
        counts[f"{kind}, code set"] += names != "-"
        counts[f"{kind}, named exactly"] += names == wanted
        counts[f"{kind}, test completed"] += completed
        print(
            f"{experiment.name:42s} found {names:42s} first {first_s:6.0f} s  "
            f"paper's rule {100 * paper:5.1f} % of windows{'' if completed else '  not completed'}",
            flush=True,
        )
    for what, count in sorted(counts.items()):
        print(f"{what}: {count}")


if __name__ == "__main__":
    main()
