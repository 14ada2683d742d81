"""Tables of simulated cars against what their equations say: errors, coverage, filled cells.

Every vehicle has an engine of its own (port or direct injection, speed density or air meter) and
two logged drives of 20 minutes with a record every 50 ms. The vehicles of the report were not used
to choose anything; those of the calibration set ``[widening]`` in ``training/ecu_tables``.

python -m benchmarks tables [--calibrate] [--vehicles N] [--seconds 1200]
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.outcome import BenchmarkOptions, Row, finish, say
from training.dyno.engine import INJECTIONS, METERINGS, EngineLayout
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment
from training.dyno.truth import tables as truth
from training.ecu_tables import config, fit, signals, tables
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


def main(argv: Sequence[str]) -> int:
    """Simulate, fit and compare."""
    options = BenchmarkOptions(__name__, __doc__, vehicles=1, seconds=150.0)
    options.add_argument("--calibrate", action="store_true", help="the vehicles of the calibration")
    options.add_argument("--vehicles", type=int, help="number of vehicles (default: all)")
    options.add_argument("--seconds", type=float, default=1200.0, help="of each drive")
    args = options.parse_args(argv)
    vehicles = (CALIBRATION if args.calibrate else REPORT)[: args.vehicles]
    cells: list[dict[str, Any]] = []
    for place, vehicle in enumerate(vehicles):
        layout = EngineLayout(INJECTIONS[place % 2], METERINGS[place // 2 % 2])
        cells += of_vehicle(vehicle, layout, args.seconds)
        say(f"{vehicle} {layout.name}: {len(cells)} cells so far")
    names = dict.fromkeys(cell["table"] for cell in cells)
    return finish(args, [row_of(n, [c for c in cells if c["table"] == n]) for n in names])


def of_vehicle(vehicle: int, layout: EngineLayout, seconds: float) -> list[dict[str, Any]]:
    """Return every cell of one vehicle with estimate, bounds, truth and seconds."""
    recordings, own = [], None
    with tempfile.TemporaryDirectory() as folder:
        for k, cycle in enumerate(CYCLES):
            experiment = Experiment(
                cycle=cycle,
                layout=layout,
                vehicle=vehicle,
                seed=100 * vehicle + k,
                duration_s=seconds,
            )
            own = experiment.engine
            recordings.append(load(write(experiment, Path(folder), "parquet", PERIOD_S)))
    assert own is not None
    subject = signals.subject_of(recordings, displacement_l=2.0)
    axes = axes_of(subject.load)
    made = tables.tables(fit.fit(subject), axes, config.defaults())
    degc = [float(np.nanmean(r.column("manifold_temperature_degc"))) for r in recordings]
    true = {t.key: t for t in truth.tables(own, axes, float(np.mean(degc)))}
    return [c for t in made if t.key in true for c in _cells(t, true[t.key], vehicle, layout)]


def _cells(
    table: EcuTable, true: EcuTable, vehicle: int, layout: EngineLayout
) -> list[dict[str, Any]]:
    return [
        {
            "vehicle": vehicle,
            "layout": layout.name,
            "table": table.name,
            "key": table.key,
            "at": list(at),
            "seconds": float(table.samples[at] * PERIOD_S),
            "estimate": float(table.estimate[at]),
            "low": float(table.low[at]),
            "high": float(table.high[at]),
            "true": float(true.estimate[at]),
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
