"""How much of lambda the recorded signals explain on runs left out, by an independent learner.

Real recordings of two Bosch engines (boschresearch/Bosch-Engine-Datasets, CC BY-SA 4.0; 10 Hz,
z-scored by their authors), split as in ``bosch_verdicts.py``. Gradient-boosted trees read the
inputs of the network as means over lags, without past lambda; then also filtered over a minute,
with the exhaust's temperatures, and with the analysers, which no car has. *Own part*: the first 60
% of the judged run train, too, and every row is scored on the last 40 %, a minute later. A
network's free run stands beside, with the mean of both.

Figures are of all runs left out of an engine: the fit in percent, and the share of lambda's
variance within windows of 5 s, which the response test lives on, that is explained. Fuel cuts and
5 s after are left out.

    python benchmarks/bosch_explained.py FOLDER ENGINE [--models FOLDER]

ENGINE is 1 or 2; FOLDER holds its runs, the folder of models SPLIT.onnx. It needs scikit-learn.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from bosch import INPUTS, OUTPUT
from bosch_outputs import fuel_cut
from bosch_verdicts import SPLITS, Split
from scipy.signal import lfilter
from sklearn.ensemble import HistGradientBoostingRegressor

from monitor.base.types import BoolArray, FloatArray
from monitor.model.step import Model
from training.narx.structure import boxes
from training.recordings import metrics
from training.recordings.recording import Recording, load
from training.studies.evaluation import predict

TEMPERATURES: Final = ("t_exh_manifold_z", "t_cat1_z")
ANALYSERS: Final = ("pn_z", "co_z", "co2_z", "hc_z", "nox_z", "o2_z")
LAGS: Final = boxes(60)
SECONDS: Final = {"6 s": (), "10 s": (3.0, 10.0), "60 s": (3.0, 10.0, 30.0, 60.0)}
PERIOD_S: Final = 0.1
WASHOUT: Final = 60
WINDOW: Final = 50
OWN: Final = 0.6  # first part of a run
GUARD: Final = 600  # samples between both parts
TREES: Final = {"max_iter": 200, "learning_rate": 0.06, "max_leaf_nodes": 24}


@dataclass(frozen=True, slots=True)
class Run:
    """One run: lambda, the rows that count, and the recording with its other signals."""

    recording: Recording
    y: FloatArray
    on: BoolArray

    def part(self, *, last: bool) -> BoolArray:
        """Return the rows of the first or of the last part."""
        rows = np.arange(len(self.y))
        edge = int(OWN * len(rows))
        return self.on & (rows >= edge + GUARD if last else rows < edge)


def run_of(path: Path) -> Run:
    recording = load(path)
    on = np.arange(len(recording.values)) >= WASHOUT
    if "fuel_cutoff_z" in recording.names:
        on &= ~fuel_cut(recording)
    return Run(recording, recording.column(OUTPUT), on)


def regressors(run: Run, names: Sequence[str], filters_s: Sequence[float]) -> FloatArray:
    """Return means over boxes of lags and first-order filters of the signals, (n, k)."""
    columns = []
    for name in names:
        x = run.recording.column(name)
        for first, stop in LAGS:
            past = np.concatenate((np.full(stop - 1, x[0]), x))
            width = stop - first
            columns.append(np.convolve(past, np.full(width, 1 / width), "valid")[: len(x)])
        for tau_s in filters_s:
            a = np.exp(-PERIOD_S / tau_s)
            columns.append(lfilter([1 - a], [1, -a], x, zi=[a * x[0]])[0])
    return np.stack(columns, axis=1)


def learned(
    split: Split, runs: dict[int, Run], x: dict[int, FloatArray], *, own: bool
) -> dict[int, FloatArray]:
    """Return the predictions of the split's test runs."""

    def fitted(test: int | None) -> HistGradientBoostingRegressor:
        parts = [(x[n][runs[n].on][::2], runs[n].y[runs[n].on][::2]) for n in split.training]
        if test is not None:
            rows = runs[test].part(last=False)
            parts += [(x[test][rows], runs[test].y[rows])]
        u, y = (np.concatenate(each) for each in zip(*parts, strict=True))
        return HistGradientBoostingRegressor(
            min_samples_leaf=60, l2_regularization=1.0, random_state=0, **TREES
        ).fit(u, y)

    common = None if own else fitted(None)
    return {n: (common or fitted(n)).predict(x[n]) for n in split.test}


def within(values: FloatArray, on: BoolArray) -> FloatArray:
    """Return the values of whole windows about their means, (n_windows, WINDOW)."""
    n = len(values) // WINDOW * WINDOW
    whole = on[:n].reshape(-1, WINDOW).all(axis=1)
    windows = values[:n].reshape(-1, WINDOW)[whole]
    return windows - windows.mean(axis=1, keepdims=True)


def row(
    title: str,
    runs: dict[int, Run],
    predicted: dict[int, FloatArray],
    part: Callable[[Run], BoolArray],
) -> None:
    ons = {n: part(runs[n]) & np.isfinite(p) for n, p in predicted.items()}
    y = np.concatenate([runs[n].y[on] for n, on in ons.items()])
    p = np.concatenate([predicted[n][on] for n, on in ons.items()])
    moved = np.concatenate([within(runs[n].y, on) for n, on in ons.items()])
    left = np.concatenate([within(runs[n].y - predicted[n], on) for n, on in ons.items()])
    share = 1.0 - np.square(left).sum() / np.square(moved).sum()
    print(f"| {title} | {metrics.fit_percent(y, p):.1f} | {share:.3f} |", flush=True)


def main() -> None:
    """Print a table, one row per set of signals."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("engine", choices=("1", "2"))
    parser.add_argument("--models", type=Path)
    args = parser.parse_args()
    splits = {name: split for name, split in SPLITS.items() if name[0] == args.engine}
    numbers = sorted({n for split in splits.values() for n in split.test})
    runs = {n: run_of(args.folder / f"run_{n:06d}.csv.gz") for n in numbers}
    inputs = INPUTS if args.engine == "1" else INPUTS[:-1]
    names = runs[numbers[0]].recording.names
    context = (*inputs, *TEMPERATURES)
    analysers = (*context, *(n for n in ANALYSERS if n in names))
    all_rows, last = (lambda run: run.on), (lambda run: run.part(last=True))
    print("| signals, memory | fit % | explained within windows |\n|---|---|---|")

    def trees(signals: Sequence[str], seconds: str, *, own: bool = False) -> dict[int, FloatArray]:
        x = {n: regressors(run, signals, SECONDS[seconds]) for n, run in runs.items()}
        found: dict[int, FloatArray] = {}
        for split in splits.values():
            found |= learned(split, runs, x, own=own)
        return found

    for seconds in SECONDS:
        row(f"inputs, {seconds}", runs, trees(inputs, seconds), all_rows)
    plain = trees(inputs, "10 s")
    row("and temperatures, 10 s", runs, trees(context, "10 s"), all_rows)
    row("and temperatures, 60 s", runs, trees(context, "60 s"), all_rows)
    row("and analysers, 10 s", runs, trees(analysers, "10 s"), all_rows)
    row("inputs, 10 s, last part", runs, plain, last)
    row("… own first part learned, too", runs, trees(inputs, "10 s", own=True), last)
    if args.models:
        network: dict[int, FloatArray] = {}
        for name, split in splits.items():
            model = Model.load(args.models / f"{name}.onnx")
            network |= {n: predict(model, runs[n].recording, WASHOUT)[1] for n in split.test}
        row("network", runs, network, all_rows)
        row("network, last part", runs, network, last)
        mean = {n: (p + plain[n]) / 2 for n, p in network.items()}
        row("mean of network and trees", runs, mean, all_rows)


if __name__ == "__main__":
    main()
