"""Tables of simulated cars against what their equations say: errors, coverage, filled cells.

Every vehicle has an engine of its own (port or direct injection, speed density or air meter) and
two logged drives of 20 minutes with a record every 50 ms. The vehicles of the report were not used
to choose anything; those of the calibration set ``[widening]`` in ``training/ecu_tables``.

With ``--logs``, tables of disjoint sets of one car's own logs: the two halves of each log, every
two logs, the first halves of all against the second ones, and each half against the one that
follows. Nobody knows the truth there, but intervals of 90 % of the common cells should overlap;
cells count as ``o2train tables --rough`` writes them.

python -m benchmarks tables [--calibrate] [--vehicles N] [--seconds 1200]
python -m benchmarks tables --logs LOG… [--columns FILE] [--displacement-l L]
"""

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any, get_args

import numpy as np

from benchmarks.outcome import BenchmarkOptions, Row, finish, say
from benchmarks.verdicts.true_tables import true_tables
from monitor.base.types import FloatArray
from training.dyno.engine import EngineLayout, Injection, Metering
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment
from training.ecu_tables import config, fit, signals, tables
from training.ecu_tables.signals import TableSubject
from training.recordings.ecu_table import EcuTable, axes_of
from training.recordings.recording import load

REPORT, CALIBRATION = range(501, 521), (*range(301, 313), *range(401, 421))
CYCLES = ("wltc_3b", "micro_trips")
PERIOD_S = 0.05
FILLED_S = 30.0
SMALL_FILM = 0.01  # error of a fraction that is next to none
TARGETS = {  # table → (largest error, relative)
    "lambda_delay": (0.020, False),
    "wall_film_fraction": (0.15, True),
    "wall_film_time": (0.15, True),
    "injector_dead_time": (0.05, False),
}
OVERLAP = 0.9  # share of the common cells


def main(argv: Sequence[str]) -> int:
    """Simulate, fit and compare."""
    options = BenchmarkOptions(__name__, __doc__, vehicles=1, seconds=150.0)
    options.add_argument("--calibrate", action="store_true", help="the vehicles of the calibration")
    options.add_argument("--vehicles", type=int, help="number of vehicles (default: all)")
    options.add_argument("--seconds", type=float, default=1200.0, help="of each drive")
    options.add_argument("--logs", type=Path, nargs="+", help="logs of one real car")
    options.add_argument("--columns", type=Path, help="profile of the logs")
    options.add_argument("--displacement-l", type=float, help="of the car of the logs")
    args = options.parse_args(argv)
    if args.logs:
        return of_logs(args)
    vehicles = (CALIBRATION if args.calibrate else REPORT)[: args.vehicles]
    cells: list[dict[str, Any]] = []
    for place, vehicle in enumerate(vehicles):
        layout = EngineLayout(get_args(Injection)[place % 2], get_args(Metering)[place // 2 % 2])
        cells += of_vehicle(vehicle, layout, args.seconds)
        say(f"{vehicle} {layout.name}: {len(cells)} cells so far")
    names = dict.fromkeys(cell["table"] for cell in cells)
    return finish(args, [row_of(n, [c for c in cells if c["table"] == n]) for n in names])


def of_logs(args: argparse.Namespace) -> int:
    """Fit disjoint sets of one car's logs; return 1 if too few of their common cells overlap."""
    slowest_s = max(load(path, columns=args.columns).period_ns for path in args.logs) / 1e9
    recordings = [load(path, period_s=slowest_s, columns=args.columns) for path in args.logs]
    whole, rows = signals.subject_of(recordings, displacement_l=args.displacement_l), list[Row]()
    for name, *sets in disjoint(whole):
        made = [tables.tables(fit.fit(each), axes_of(each.load), config.rough()) for each in sets]
        flows = [t.estimate[0] for of in made for t in of if t.name == "injector_flow_scale"]
        n, n_apart = np.sum([overlap(*pair) for pair in zip(*made, strict=True)], axis=0).tolist()
        told = dict(zip(("flow mg/ms", "flow of the others"), map(float, flows), strict=False))
        rows.append({"sets": name, "common cells": n, "apart": n_apart, **told})
        say(f"{name}: {n} common cells, {n_apart} apart")
    n, n_apart = (sum(int(row[key] or 0) for row in rows) for key in ("common cells", "apart"))
    rows.append({"sets": "all", "common cells": n, "apart": n_apart})
    short = n_apart > (1.0 - OVERLAP) * n
    return finish(args, rows, [f"{n - n_apart} of {n} common cells overlap"] if short else [])


def disjoint(whole: TableSubject) -> Iterator[tuple[str, TableSubject, TableSubject]]:
    """Yield pairs of sets of a car's logs that share no sample, each with its name."""
    logs = [replace(whole, drives=(drive,)) for drive in whole.drives]
    halves = [tuple(half.drives[0] for half in log.logs()) for log in logs]
    for log, two in zip(logs, halves, strict=True):
        yield f"{log.drives[0].name}: halves", *(replace(whole, drives=(h,)) for h in two)
    for one, other in combinations(logs, 2):
        yield f"{one.drives[0].name} and {other.drives[0].name}", one, other
    if len(logs) > 1:
        for name, turn in (("first and second halves", 0), ("halves in turn", 1)):
            sides = [[two[(k * turn + s) % 2] for k, two in enumerate(halves)] for s in (0, 1)]
            yield name, *(replace(whole, drives=tuple(side)) for side in sides)


def overlap(one: EcuTable, other: EcuTable) -> tuple[int, int]:
    """Return how many cells both tables fill, and in how many the intervals do not overlap."""
    common = np.isfinite(one.estimate) & np.isfinite(other.estimate)
    apart = common & ((one.high < other.low) | (other.high < one.low))
    return int(common.sum()), int(apart.sum())


def of_vehicle(vehicle: int, layout: EngineLayout, seconds: float) -> list[dict[str, Any]]:
    """Return every cell of one vehicle with estimate, bounds, truth and seconds."""
    recordings, own = [], None
    with tempfile.TemporaryDirectory() as folder:
        for k, cycle in enumerate(CYCLES):
            seed = 100 * vehicle + k
            experiment = Experiment(cycle, vehicle, seed, duration_s=seconds, layout=layout)
            own = experiment.engine
            recordings.append(load(write(experiment, Path(folder), "parquet", PERIOD_S)))
    assert own is not None
    subject = signals.subject_of(recordings, displacement_l=2.0)
    axes = axes_of(subject.load)
    made = tables.tables(fit.fit(subject), axes, config.defaults())
    degc = [float(np.nanmean(r.column("manifold_temperature_degc"))) for r in recordings]
    true = true_tables(own, axes, float(np.mean(degc)))
    return [c for t in made if t.key in true for c in _cells(t, true[t.key])]


def _cells(table: EcuTable, true: FloatArray) -> list[dict[str, Any]]:
    return [
        {
            "table": table.name,
            "seconds": float(table.samples[at] * PERIOD_S),
            "estimate": float(table.estimate[at]),
            "low": float(table.low[at]),
            "high": float(table.high[at]),
            "true": float(true[at]),
        }
        for at in np.ndindex(table.estimate.shape)
        if table.samples[at] > 0
    ]


def row_of(name: str, cells: list[dict[str, Any]]) -> Row:
    """Return the figures of a table's cells."""
    keys = ("seconds", "estimate", "low", "high", "true")
    of = {k: np.array([c[k] for c in cells]) for k in keys}
    filled, long = np.isfinite(of["estimate"]), of["seconds"] >= FILLED_S
    e = {k: v[filled] for k, v in of.items()}
    error = np.abs(e["estimate"] - e["true"])
    relative, covered = error / e["true"], (e["low"] <= e["true"]) & (e["true"] <= e["high"])
    most, is_relative = TARGETS.get(name, (np.nan, False))
    met = (relative if is_relative else error) <= most
    with np.errstate(all="ignore"):
        widening = np.abs(np.log(e["estimate"] / e["true"])) / np.log(e["high"] / e["estimate"])
    return {
        "table": name,
        "cells": int(filled.sum()),
        "filled of 30 s, %": _percent(filled[long]),
        "error p50": _quantile(error, 0.5),
        "error p95": _quantile(error, 0.95),
        "relative p50": _quantile(relative, 0.5),
        "relative p95": _quantile(relative, 0.95),
        "within target, %": _percent(met) if name in TARGETS else None,
        "or error small, %": _percent(met | (error <= SMALL_FILM)) if "film_f" in name else None,
        "covered, %": _percent(covered),
        "widening x": _quantile(widening, 0.9),
    }


def _percent(which: np.ndarray) -> float | None:
    return 100.0 * float(which.mean()) if which.size else None


def _quantile(values: np.ndarray, q: float) -> float | None:
    return float(np.nanquantile(values, q)) if values.size else None
