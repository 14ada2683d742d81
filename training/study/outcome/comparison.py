"""Linear models on the study's recordings, and the NARX on the same samples."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from monitor.base.signals import BY_NAME
from monitor.base.types import FloatArray
from training.jobs.json_tree import plain
from training.narx.linear.regressors import Stretch as Pair
from training.narx.network import Spec
from training.narx.stages import free_run
from training.recordings import metrics
from training.recordings.linear_data import LinearData, Stretch, linear_stretches
from training.recordings.preparation import Role
from training.recordings.rows import runs
from training.study.linear.baselines import Regime, linear
from training.study.task import Task, judged_on

SPEEDS = ("engine_speed_rpm", "speed_z")
TITLES = {
    "arx_free_run": "ARX, orders by free run",
    "arx_aic": "ARX, orders by AIC",
    "arx_mdl": "ARX, orders by MDL",
    "arx_sum_of_squares": "ARX, orders by sum of squares",
    "subspace": "state space",
    "output_error": "output error",
}


def baselines(task: Task, band_hz: Sequence[float] | None) -> dict[str, Any]:
    """Return the linear study, with the same training, validation and test samples as the NARX.

    band_hz : [low, high] of the noise band; a zero-phase filter removes it; None for no filter
    Raises RecordingError if the samples are too few.
    """
    prepared, parts = _stretches(task, band_hz)
    pairs = {
        role: [_pair(task, prepared, p, own) for p in each] for role, (own, each) in parts.items()
    }
    regime = _regime(task, *parts[Role.TEST])
    result = linear(
        pairs[Role.TRAIN],
        pairs[Role.VALIDATE],
        pairs[Role.TEST],
        task.inputs,
        task.output,
        period_s=task.recordings[0].period_ns / 1e9,
        unit="z-scored",
        regime=regime,
    )
    return result | {"band_hz": list(band_hz) if band_hz else None}


Parts = dict[Role, tuple[Sequence[Any], list[Stretch]]]


def _stretches(task: Task, band_hz: Sequence[float] | None) -> tuple[LinearData, Parts]:
    """Return the linear preparation, and by role the recordings with their filtered stretches."""
    whole, prepared = linear_stretches(task.recordings, task.inputs, task.output, band_hz)
    roles = [np.full(len(r.t_s), -1, dtype=np.int8) for r in task.recordings]
    for s in task.data.segments:
        roles[s.recording][s.first : s.first + s.stop - s.start] = task.data.role[s.start : s.stop]
    parts: Parts = {role: (task.recordings, []) for role in Role}
    for stretch in whole:
        own = roles[stretch.recording][stretch.first : stretch.first + len(stretch.t_s)]
        for role, (_, found) in parts.items():
            for a, b in runs(own == role):
                found.append(
                    Stretch(
                        stretch.recording, stretch.first + a, stretch.t_s[a:b], stretch.values[a:b]
                    )
                )
    if task.test:
        drives, _ = linear_stretches(task.test, task.inputs, task.output, reference=prepared)
        parts[Role.TEST] = (task.test, drives)
    return prepared, parts


def _pair(task: Task, prepared: LinearData, part: Stretch, own: Sequence[Any]) -> Pair:
    z = prepared.apply(part.values, part.t_s, own[part.recording].sha256)
    return z[:, :-1], z[:, -1]


def _regime(task: Task, recordings: Sequence[Any], parts: Sequence[Stretch]) -> Regime | None:
    """Return engine speed over the test stretches, or an input with "speed" in its name.

    Return None without such a signal.
    """
    common = [n for n in recordings[0].names if all(n in r.names for r in recordings)]
    known = [n for n in SPEEDS if n in common] + [n for n in task.inputs if "speed" in n]
    if not known:
        return None
    name = known[0]
    unit = BY_NAME[name].unit if name in BY_NAME else ""
    values = [recordings[p.recording].column(name)[p.first : p.first + len(p.t_s)] for p in parts]
    return Regime(name, unit, values)


def beside(
    task: Task, linear_result: Mapping[str, Any], spec: Spec, weights: FloatArray
) -> dict[str, Any]:
    """Return the fits of the NARX and of the linear models on the same test samples.

    The NARX runs freely from the start of every recording. If the linear models use filtered data,
    the NARX's prediction and the measurement go through the same filter.
    """
    regime = linear_result["regime"]
    prepared, parts = _stretches(task, linear_result["band_hz"])
    recordings, stretches = parts[Role.TEST]
    held = judged_on(task)
    predicted = held.scaling.unscale_y(free_run(held, spec, weights))
    rows = [np.full(len(r.t_s), np.nan) for r in recordings]
    for s in held.segments:
        rows[s.recording][s.first : s.first + s.stop - s.start] = predicted[s.start : s.stop]
    skip = linear_result["skip"]
    measured, own, speed = [], [], []
    for index, p in enumerate(stretches):
        if len(p.t_s) < 2 * skip:
            continue
        run = rows[p.recording][p.first : p.first + len(p.t_s)]
        measured.append(p.values[skip:, -1])
        own.append(_filtered(prepared, run)[skip:])
        if regime is not None:
            values = _regime(task, recordings, stretches)
            speed.append(np.asarray(values.values[index])[skip:] if values else run[skip:])
    y, y_hat = np.concatenate(measured), np.concatenate(own)
    good = np.isfinite(y_hat)
    where = np.concatenate(speed) if speed else np.zeros(len(y))
    ranges = regime["ranges"] if regime else []
    masks = [
        good & (where >= _or(low, -np.inf)) & (where < _or(high, np.inf)) for low, high in ranges
    ]
    models = {
        name: {
            "parameters": m["parameters"],
            "fit_percent": m["fit_percent"],
            "correlation": m["correlation"],
            "regime_fit_percent": m["regime_fit_percent"],
        }
        for name, m in linear_result["models"].items()
    }
    narx = {
        "parameters": spec.n_weights,
        "fit_percent": _fit(y[good], y_hat[good]),
        "correlation": metrics.correlation(y[good], y_hat[good]),
        "regime_fit_percent": [_fit(y[m], y_hat[m]) for m in masks],
    }
    return plain(
        {
            "narx": narx,
            "models": models,
            "regime": regime,
            "samples": int(good.sum()),
            "best_linear": linear_result["best"],
            "filtered": prepared.filter is not None,
        }
    )


def _filtered(prepared: LinearData, run: FloatArray) -> FloatArray:
    if prepared.filter is None or not np.isfinite(run).any():
        return run
    known = np.isfinite(run)
    at = np.arange(len(run))
    whole = np.interp(at, at[known], run[known])
    return np.asarray(np.where(known, prepared.filter.apply(whole[:, None])[:, 0], np.nan))


def _or(value: float | None, other: float) -> float:
    return other if value is None else value


def _fit(measured: FloatArray, predicted: FloatArray) -> float | None:
    if len(measured) < 2 or np.ptp(measured) == 0.0:
        return None
    return metrics.fit_percent(measured, predicted)
