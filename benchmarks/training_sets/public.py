"""Free run on benchmarks of system identification, beside other packages.

FOLDER holds the files of ``nonlinear_benchmarks``, see public_data.py; a plant without a file is
skipped with a line. Without FOLDER the plants are synthetic (synthetic_plants.py). ``fit`` runs
with its defaults. ARX is the best in free run of all orders up to 20, FROLS (SysIdentPy) of lags 2,
3, 5 and degrees 1 to 3, jax-sysid the residual network of its guide. RMSE in free run, median and
worst of the seeds. A missing package is skipped with a line.

pip install --no-deps -r benchmarks/requirements.txt
python -m benchmarks public [FOLDER] [--plants NAME ...] [--models NAME ...] [--seeds 5]
"""

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.outcome import BenchmarkOptions, Row, finish, say
from benchmarks.speed.training_packages import MissingError
from benchmarks.training_sets.public_data import PLANTS, Plant, find
from benchmarks.training_sets.public_models import EPOCHS, MODELS, Work, rmse
from benchmarks.training_sets.synthetic_plants import SYSTEMS
from training.recordings.metrics import fit_percent


def measure(
    plant: Plant, models: Sequence[str], seeds: int, budget_minutes: float, epochs: int
) -> list[Row]:
    """Return a row for each test and model, and say how each training went."""
    errors: dict[tuple[str, str], list[float]] = {}
    fits: dict[tuple[str, str], float] = {}
    for name in models:
        train, drawn = MODELS[name]
        for seed in range(seeds if drawn else 1):
            began_s = time.monotonic()
            try:
                runs, shape = train(plant, Work(budget_minutes, seed, epochs))
            except MissingError as missing:
                say(f"{plant.name}: {name} is skipped: {missing}")
                break
            for test, free in runs.items():
                record, error = plant.tests[test], rmse(plant.tests[test], free, plant)
                errors.setdefault((test, name), []).append(error)
                if seed == 0 and np.isfinite(error):
                    measured = record.y[plant.washout :]
                    fits[test, name] = fit_percent(measured, free[plant.washout : len(record.y)])
            say(f"{plant.name}: {name} ({shape}) {seed}: {time.monotonic() - began_s:.0f} s")
    return [
        {
            "plant": plant.name,
            "test": test,
            "unit": plant.unit,
            "model": model,
            "RMSE": float(np.median(errors[test, model])),
            "worst": max(errors[test, model]),
            "fit_percent": fits.get((test, model)),
            "goal": plant.goals.get(test) if model == "NARX" else None,
        }
        for test in plant.tests
        for model in models
        if (test, model) in errors
    ]


def main(argv: Sequence[str]) -> int:
    """Train and test all models on all plants."""
    smallest = {"plants": ["tanks"], "seeds": 1, "budget": 0.01, "epochs": 3}
    options = BenchmarkOptions(__name__, __doc__, **smallest)
    names = list(dict.fromkeys((*PLANTS, *SYSTEMS)))
    options.add_argument("folder", nargs="?", type=Path, metavar="FOLDER")
    options.add_argument("--plants", nargs="+", choices=names, default=names, metavar="NAME")
    options.add_argument("--models", nargs="+", choices=MODELS, default=list(MODELS))
    options.add_argument("--seeds", type=int, default=5)
    options.add_argument("--budget", type=float, default=10.0, metavar="MINUTES", help="of one fit")
    options.add_argument("--epochs", type=int, default=EPOCHS, help="of jax-sysid")
    args = options.parse_args(argv)
    rows: list[Row] = []
    for name in args.plants:
        plant = None
        if args.folder is None:
            plant = SYSTEMS[name]() if name in SYSTEMS else None
        elif name in PLANTS:
            plant = find(args.folder, name)
            if plant is None:
                say(f"{name}: no {PLANTS[name][0]} below {args.folder}, skipped")
        if plant is not None:
            rows += measure(plant, args.models, args.seeds, args.budget, args.epochs)
    return finish(args, rows)
