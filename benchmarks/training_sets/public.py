"""Free run on public benchmarks of system identification, beside other packages.

FOLDER holds the files of ``nonlinear_benchmarks``, see public_data.py; a plant without a file is
skipped with a line. ``fit`` runs with its defaults. ARX is the best in free run of all orders up to
20, FROLS (SysIdentPy) of lags 2, 3, 5 and degrees 1 to 3, jax-sysid the residual network of its
guide. RMSE in free run, median and worst of the seeds.

    pip install --no-deps -r benchmarks/requirements.txt
    python -m benchmarks public FOLDER [--plants NAME ...] [--models NAME ...] [--seeds N]
        [--budget MINUTES] [--json FILE]
    python -m benchmarks public FOLDER --stand-ins     writes synthetic files into FOLDER first

A missing package is skipped with a line.
"""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.speed.training_packages import MissingError
from benchmarks.training_sets.public_data import PLANTS, Plant, find, plant_of
from benchmarks.training_sets.public_models import EPOCHS, MODELS, Work, rmse
from benchmarks.training_sets.public_stand_ins import write

Errors = dict[str, dict[str, list[float]]]  # model, test, one RMSE per seed
HEADER = "| plant, test | unit | {models} | NARX : best of the others | goal |"


def measure(
    plant: Plant, models: list[str], seeds: int, budget_minutes: float, epochs: int
) -> Errors:
    """Return the errors of every model, and say on stderr how each training went."""
    errors: Errors = {}
    for name in models:
        train, drawn = MODELS[name]
        for seed in range(seeds if drawn else 1):
            began_s = time.monotonic()
            try:
                runs, shape = train(plant, Work(budget_minutes, seed, epochs))
            except MissingError as missing:
                print(f"{plant.name}: {name} is skipped: {missing}", file=sys.stderr)
                break
            found = {test: rmse(plant.tests[test], free, plant) for test, free in runs.items()}
            for test, error in found.items():
                errors.setdefault(name, {}).setdefault(test, []).append(error)
            said = ", ".join(f"{test} {error:.4g} {plant.unit}" for test, error in found.items())
            print(
                f"{plant.name}: {name} ({shape}), seed {seed}: {said}; "
                f"{time.monotonic() - began_s:.0f} s",
                file=sys.stderr,
                flush=True,
            )
    return errors


def row(plant: Plant, test: str, errors: Errors, models: list[str]) -> str:
    """Return the table's row of one test: median, and worst where seeds were drawn."""
    medians = {m: float(np.median(e[test])) for m, e in errors.items()}
    cells = []
    for model in models:
        values = errors.get(model, {}).get(test)
        cells.append("-" if values is None else _cell(values))
    others = [value for model, value in medians.items() if model != "NARX"]
    known = "NARX" in medians and bool(others) and np.isfinite(min(others))
    ratio = f"{medians['NARX'] / min(others):.2f}" if known else "-"
    goal = f"≤ {plant.goals[test]:g}" if test in plant.goals else "-"
    return f"| {plant.name}, {test} | {plant.unit} | {' | '.join(cells)} | {ratio} | {goal} |"


def _cell(values: list[float]) -> str:
    median, worst = (
        f"{v:.3g}" if np.isfinite(v) else "diverges" for v in (np.median(values), max(values))
    )
    return median if len(values) == 1 else f"{median} ({worst})"


def main(argv: Sequence[str]) -> int:
    """Print a table with one row per test."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("--plants", nargs="+", choices=PLANTS, default=list(PLANTS), metavar="NAME")
    parser.add_argument("--models", nargs="+", choices=MODELS, default=list(MODELS), metavar="NAME")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--budget", type=float, default=10.0, metavar="MINUTES", help="of one fit")
    parser.add_argument("--epochs", type=int, default=EPOCHS, help="of jax-sysid")
    parser.add_argument("--stand-ins", action="store_true", help="write synthetic files first")
    parser.add_argument("--json", type=Path, metavar="FILE", help="every error")
    args = parser.parse_args(argv)
    if args.stand_ins:
        write(args.folder)
    everything, rows = {}, []
    for name in args.plants:
        file = find(args.folder, name)
        if file is None:
            print(f"{name}: no {PLANTS[name][0]} below {args.folder}, skipped", file=sys.stderr)
            continue
        plant = plant_of(name, file)
        errors = measure(plant, args.models, args.seeds, args.budget, args.epochs)
        rows += [row(plant, test, errors, args.models) for test in plant.tests]
        everything[name] = {"unit": plant.unit, "rmse": errors}
        if args.json:
            args.json.write_text(json.dumps(everything, indent=1))
    if not rows:
        print("no plant was measured", file=sys.stderr)
        return 2
    print(HEADER.format(models=" | ".join(args.models)))
    print("|---" * (4 + len(args.models)) + "|")
    print("\n".join(rows))
    return 0
