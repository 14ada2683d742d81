"""Comparison of input sets: the same small NARX, in free run on the same samples."""

import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from monitor.base.types import FloatArray
from training.narx.network import Spec
from training.narx.stages import Trained, free_run, train
from training.recordings import metrics
from training.recordings.augmentation import CONTROLLER
from training.recordings.outliers import outlier_mask
from training.recordings.preparation import Prepared, Role, Samples, prepare
from training.recordings.recording import Recording
from training.recordings.rows import runs

LAGS, HIDDEN, HORIZONS, STARTS = 5, (8,), (5, 20, 100), 2  # lags and horizons in samples
MOST_TRAINING = 24_000  # samples, enough for a few hundred weights; the rest is for testing
WINDOW = 1800  # samples of a part that as a whole trains or tests
BOOTSTRAP_BLOCK = 100  # samples drawn together, longer than the memory of a residual
DRAWS = 2000  # of the bootstrap
NEGLIGIBLE = 0.1  # of the RMSE; a smaller difference does not justify an input


@dataclass(frozen=True, slots=True)
class InputSet:
    """A set of inputs; ``exact`` trains on lambda_controller without the usual added noise."""

    name: str
    inputs: tuple[str, ...]
    exact: bool = False


@dataclass(frozen=True, slots=True)
class Tried:
    """The trained networks of one input set."""

    set: InputSet
    data: Prepared
    spec: Spec
    starts: tuple[Trained, ...]
    best: int
    predicted: tuple[FloatArray, ...]  # (n,) free run in model units, one per start
    seconds: float


def aligned(recordings: Sequence[Recording], names: Sequence[str]) -> list[Recording]:
    """Return the recordings with a sample invalid in all ``names`` if it is invalid in one.

    This gives all input sets the same stretches and the same held-out blocks.
    """
    result = []
    for recording in recordings:
        values = np.array(recording.values, dtype=np.float64)
        columns = [list(recording.names).index(name) for name in names]
        good = np.ones(len(values), dtype=bool)
        for name, column in zip(names, columns, strict=True):
            good &= np.isfinite(values[:, column]) & ~outlier_mask(name, values[:, column])
        for column in columns:
            values[~good, column] = np.nan
        result.append(replace(recording, values=values))
    return result


def exact_inputs(data: Prepared) -> FloatArray:
    """Return the scaled inputs (n, k) without the noise that training adds to the controller."""
    names = [c.name for c in data.inputs]
    parts = []
    for s in data.segments:
        r = data.recordings[s.recording]
        order = [list(r.names).index(name) for name in names]
        parts.append(r.values[s.first : s.first + s.stop - s.start, order])
    return data.scaling.scale_u(np.concatenate(parts))


def try_sets(
    recordings: Sequence[Recording],
    sets: Sequence[InputSet],
    output: str,
    *,
    seed: int,
    budget_minutes: float,
    threads: int = 2,
) -> list[Tried]:
    """Return the input sets, all trained with the same recipe and number of starts.

    recordings : from ``aligned``
    budget_minutes : for all trainings together, shared equally
    """
    prepared = [_prepared(recordings, each, output, seed) for each in sets]
    tasks = [(i, k) for i in range(len(sets)) for k in range(STARTS)]
    share_s = 60.0 * budget_minutes * min(threads, len(tasks)) / len(tasks)

    def one(task: tuple[int, int]) -> tuple[Trained, float]:
        began = time.monotonic()
        data, spec = prepared[task[0]]
        start_seed = seed + 1000 * task[1]
        found = train(data, spec, start_seed, began + share_s, horizons=HORIZONS)
        return found, time.monotonic() - began

    with ThreadPoolExecutor(threads) as pool:
        results = list(pool.map(one, tasks))
    tried = []
    for i, (each, (data, spec)) in enumerate(zip(sets, prepared, strict=True)):
        own = results[i * STARTS : (i + 1) * STARTS]
        starts = tuple(t for t, _ in own)
        best = int(np.argmin([t.score for t in starts]))
        predicted = tuple(data.scaling.unscale_y(free_run(data, spec, t.weights)) for t in starts)
        tried.append(
            Tried(
                set=each,
                data=data,
                spec=spec,
                starts=starts,
                best=best,
                predicted=predicted,
                seconds=sum(s for _, s in own),
            )
        )
    return tried


def _prepared(
    recordings: Sequence[Recording], each: InputSet, output: str, seed: int
) -> tuple[Prepared, Spec]:
    data = prepare(recordings, each.inputs, output, lags=LAGS, seed=seed)
    if each.exact and CONTROLLER in each.inputs:
        samples = Samples(exact_inputs(data), data.samples.y, data.samples.weight)
        data = replace(data, samples=samples)
    data = replace(data, role=_roles(data))
    scale = data.scaling
    low, high = float(scale.scale_y(scale.y_low)), float(scale.scale_y(scale.y_high))
    spec = Spec(
        n_inputs=len(each.inputs),
        lags=LAGS,
        hidden=HIDDEN,
        input_lag_start=1,
        y_min=low,
        y_max=high,
    )
    return data, spec


def _roles(data: Prepared) -> np.ndarray:
    """Return the roles (n,); windows beyond ``MOST_TRAINING`` samples become test samples."""
    role = data.role.copy()
    keep = min(1.0, MOST_TRAINING / len(role))
    for s in data.segments:
        window = (s.first + np.arange(s.stop - s.start)) // WINDOW
        kept = np.floor((window + 1) * keep) > np.floor(window * keep)
        role[s.start : s.stop][~kept] = Role.TEST
    return role


def scored_rows(tried: Sequence[Tried]) -> np.ndarray:
    """Return a mask (n,) bool of the enabled test samples that all sets predict.

    If no test sample is enabled, all test samples count.
    """
    data = tried[0].data
    valid = (data.role == Role.TEST) & (data.samples.weight > 0)
    for each in tried:
        valid &= np.all([np.isfinite(p) for p in each.predicted], axis=0)
    enabled = valid & data.enabled
    return enabled if enabled.any() else valid


def figures(tried: Tried, rows: np.ndarray) -> dict[str, Any]:
    """Return the free-run errors of an input set on ``rows``, in model units."""
    measured = tried.data.scaling.unscale_y(tried.data.samples.y[rows])
    predicted = tried.predicted[tried.best][rows]
    return {
        "name": tried.set.name,
        "inputs": list(tried.set.inputs),
        "exact": tried.set.exact,
        "weights": tried.spec.n_weights,
        "samples": int(rows.sum()),
        "rmse": metrics.rmse(measured, predicted),
        "fit_percent": metrics.fit_percent(measured, predicted) if np.ptp(measured) > 0 else None,
        "correlation": metrics.correlation(measured, predicted),
        "rmse_of_starts": [metrics.rmse(measured, p[rows]) for p in tried.predicted],
        "stopped_by_budget": sum(
            not t.stages or t.stages[-1].stop == "budget" or len(t.stages) <= len(HORIZONS)
            for t in tried.starts
        ),
        "seconds": round(tried.seconds, 1),
    }


def difference(one: Tried, other: Tried, rows: np.ndarray, seed: int) -> Mapping[str, float]:
    """Return the RMSE of ``one`` minus that of ``other`` with a 95 % interval, in model units.

    The interval is a bootstrap over blocks of residuals; both sets draw the same blocks.
    Source: Künsch, Annals of Statistics 17 (1989); here the blocks do not overlap.
    """
    target = one.data.scaling.unscale_y(one.data.samples.y)
    squares = np.column_stack([(t.predicted[t.best] - target) ** 2 for t in (one, other)])
    sums, counts = [], []
    for first, stop in runs(rows):
        for a in range(first, stop, BOOTSTRAP_BLOCK):
            block = slice(a, min(a + BOOTSTRAP_BLOCK, stop))
            sums.append(squares[block].sum(axis=0))
            counts.append(block.stop - block.start)
    total, n = np.array(sums), np.array(counts)
    drawn = np.random.default_rng(seed).integers(0, len(n), (DRAWS, len(n)))
    rmse = np.sqrt(total[drawn].sum(axis=1) / n[drawn].sum(axis=1)[:, np.newaxis])
    low, high = np.percentile(rmse[:, 0] - rmse[:, 1], [2.5, 97.5])
    a, b = np.sqrt(total.sum(axis=0) / n.sum())
    return {
        "difference": float(a - b),
        "low": float(low),
        "high": float(high),
        "rmse": float(b),
        "blocks": float(len(n)),
    }
