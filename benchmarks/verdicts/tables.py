"""Tables of simulated cars against what their equations say: errors, coverage, filled cells.

    python -m benchmarks tables                      the vehicles of the report
    python -m benchmarks tables --calibrate          those that set the widening of the intervals

Every vehicle has an engine of its own (port or direct injection, speed density or air meter) and
two logged drives of 20 minutes with a record every 50 ms. The vehicles of the report were not used
to choose anything; those of the calibration set ``[widening]`` in ``training/ecu_tables``.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from training.dyno import truth
from training.dyno.engine import INJECTIONS, METERINGS, Layout
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment
from training.ecu_tables import config, fit, signals, tables
from training.recordings.ecu_table import EcuTable, axes_of
from training.recordings.recording import load

REPORT, CALIBRATION = range(501, 521), (*range(301, 313), *range(401, 421))
CYCLES = ("wltc_3b", "micro_trips")
DURATION_S, PERIOD_S = 1200.0, 0.05
FILLED_S = 30.0
SMALL_FILM = 0.01  # error of a fraction that is next to none
TARGETS = {  # table → (largest error, relative)
    "lambda_delay": (0.020, False),
    "wall_film_fraction": (0.15, True),
    "wall_film_time": (0.15, True),
    "injector_dead_time": (0.05, False),
}


def main(argv: Sequence[str]) -> int:
    """Simulate, fit, compare and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--calibrate", action="store_true", help="the vehicles of the calibration")
    parser.add_argument("--vehicles", type=int, help="number of vehicles (default: all)")
    parser.add_argument("--json", type=Path, help="write all cells")
    args = parser.parse_args(argv)
    vehicles = (CALIBRATION if args.calibrate else REPORT)[: args.vehicles]
    cells: list[dict[str, Any]] = []
    for place, vehicle in enumerate(vehicles):
        layout = Layout(INJECTIONS[place % 2], METERINGS[place // 2 % 2])
        cells += of_vehicle(vehicle, layout)
        print(f"{vehicle} {layout.name}: {len(cells)} cells so far", file=sys.stderr, flush=True)
    if args.json:
        args.json.write_text(json.dumps(cells))
    for name in dict.fromkeys(c["table"] for c in cells):
        print(line(name, [c for c in cells if c["table"] == name], calibrate=args.calibrate))
    return 0


def of_vehicle(vehicle: int, layout: Layout) -> list[dict[str, Any]]:
    """Return every cell of one vehicle with estimate, bounds, truth and seconds."""
    recordings, own = [], None
    with tempfile.TemporaryDirectory() as folder:
        for k, cycle in enumerate(CYCLES):
            experiment = Experiment(
                cycle=cycle,
                layout=layout,
                vehicle=vehicle,
                seed=100 * vehicle + k,
                duration_s=DURATION_S,
            )
            own = experiment.engine
            recordings.append(load(write(experiment, Path(folder), "parquet", PERIOD_S)))
    assert own is not None
    subject = signals.subject_of(recordings, displacement_l=2.0)
    axes = axes_of(subject.load)
    made = tables.tables(fit.fit(subject), axes, config.defaults())
    degc = [float(np.nanmean(r.column("manifold_temperature_degc"))) for r in recordings]
    true = {t.key: t for t in truth.tables(own, axes, float(np.mean(degc)))}
    return [c for t in made for c in _cells(t, true[t.key], vehicle, layout)]


def _cells(table: EcuTable, true: EcuTable, vehicle: int, layout: Layout) -> list[dict[str, Any]]:
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


def line(name: str, cells: list[dict[str, Any]], *, calibrate: bool) -> str:
    """Return one line of figures of a table's cells."""
    of = {
        k: np.array([c[k] for c in cells]) for k in ("seconds", "estimate", "low", "high", "true")
    }
    filled, long = np.isfinite(of["estimate"]), of["seconds"] >= FILLED_S
    text = f"{name:20} {filled.sum():5} cells filled, {100 * filled[long].mean():3.0f} % of 30 s"
    if not filled.any():
        return text
    e = {k: v[filled] for k, v in of.items()}
    error = np.abs(e["estimate"] - e["true"])
    covered = (e["low"] <= e["true"]) & (e["true"] <= e["high"])
    text += f"; error p50 {np.median(error):.4f} p95 {np.percentile(error, 95):.4f}"
    relative = error / e["true"]
    text += f", relative p50 {100 * np.median(relative):.1f} p95 {np.percentile(relative, 95):.2f}"
    if name in TARGETS:
        most, is_relative = TARGETS[name]
        met = (relative if is_relative else error) <= most
        text += f"; within target {100 * met.mean():.1f} %"
        if name == "wall_film_fraction":
            text += f", or within {SMALL_FILM:g} {100 * (met | (error <= SMALL_FILM)).mean():.1f} %"
    text += f"; covered {100 * covered.mean():.1f} %"
    if calibrate:
        half = np.log(e["high"] / e["estimate"])
        factor = np.percentile(np.abs(np.log(e["estimate"] / e["true"])) / half, 90)
        text += f"; widening × {factor:.2f}"
    return text
