"""The chosen model against the sensor: residuals on healthy and faulty drives.

The results correspond to figures 6 and 7 of *Model Based Diagnosis of Oxygen Sensors*. Residuals
are measured minus predicted, in the output's unit, on samples that the monitor would judge.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.errors import UsageError
from monitor.base.fault_streams import SensorFault
from monitor.base.faults import resolve
from monitor.base.files import manifest
from monitor.base.types import FloatArray
from monitor.model.step import from_model_units
from training.jobs.json_tree import plain
from training.narx.model_file import measures
from training.narx.network import Spec
from training.narx.stages import free_run
from training.recordings.preparation import Prepared, Role
from training.recordings.recording import Recording
from training.recordings.rows import runs
from training.study.task import Task, as_in_use, scaled_as, source, thinned

WINDOW = 50  # samples, Model Based Diagnosis of Oxygen Sensors, section 2
EXCERPT, SCATTER = 1200, 700  # samples in the figures
BINS = 80  # of the residual's distribution
PUT_ON = (
    "slow_symmetric",
    "delay_rich_to_lean",
    "delay_symmetric",
    "transient",
    "gain_low",
    "biased_lean",
)
ANY_OUTPUT = ("slow_symmetric", "delay_symmetric")  # faults that need no zero point of the sensor
ROLES = {Role.TRAIN: "training", Role.VALIDATE: "validation", Role.TEST: "test"}


def against_sensor(
    task: Task, spec: Spec, weights: FloatArray, limits: Mapping[str, Any]
) -> dict[str, Any]:
    """Return free runs and residuals on blocks and drives, healthy and faulty.

    limits : limits of the model's card by name; ``j_mu`` and ``j_sigma`` are used
    """
    own = as_in_use(task.data)
    predicted = own.scaling.unscale_y(free_run(own, spec, weights))
    views = [
        _view(own, predicted, own.role == role, f"{name} blocks", source(task.recordings))
        for role, name in ROLES.items()
    ]
    healthy = (own, predicted, own.role == Role.TEST)
    for recording in task.test:
        one = scaled_as(task.data, [recording])
        run = one.scaling.unscale_y(free_run(one, spec, weights))
        every = np.ones(len(run), dtype=bool)
        views.append(_view(one, run, every, Path(recording.path).name, source([recording])))
    if task.test:
        drives = scaled_as(task.data, task.test)
        run = drives.scaling.unscale_y(free_run(drives, spec, weights))
        healthy = (drives, run, np.ones(len(run), dtype=bool))
    j = {k: limits[k]["value"] for k in ("j_mu", "j_sigma") if k in limits}
    span = _span(*healthy)
    return plain(
        {
            "output": task.output,
            "unit": task.data.output.unit,
            "period_s": task.data.period_ns / 1e9,
            "healthy_source": source(task.test or task.recordings),
            "healthy_on": "held-out recordings" if task.test else "test blocks",
            "views": views,
            "limits": j,
            "edges": np.linspace(-span, span, BINS + 1),
            "healthy": _residuals(*healthy, span, j),
            "unreadable": [Path(r.path).name for r in task.faulty if not _readable(task, r)],
            "faults": _faults(task, spec, weights=weights, healthy=healthy[0], span=span, j=j),
        }
    )


def _view(
    data: Prepared, predicted: FloatArray, rows: np.ndarray, title: str, origin: str
) -> dict[str, Any]:
    """Return errors, an excerpt and a scatter of the samples in ``rows`` (n,) bool."""
    measured, run = in_units(data, predicted)
    scored = rows & np.isfinite(measured) & np.isfinite(run)
    judged = scored & data.enabled if (scored & data.enabled).sum() > WINDOW else scored
    at = np.flatnonzero(judged)
    first, stop = liveliest(measured, judged, scored)
    return {
        "title": title,
        "source": origin,
        "all": measures(data, predicted, scored),
        "enabled": measures(data, predicted, judged),
        "first_s": first * data.period_ns / 1e9,
        "excerpt": {
            "measured": np.where(scored, measured, np.nan)[first:stop],
            "predicted": np.where(scored, run, np.nan)[first:stop],
        },
        "judged": judged[first:stop].astype(int),
        "scatter": {
            "measured": thinned(measured[at], SCATTER),
            "predicted": thinned(run[at], SCATTER),
        },
    }


def in_units(data: Prepared, predicted: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return measured (NaN where not valid) and predicted output (n,) in the output's unit."""
    valid = data.samples.weight > 0
    measured = np.where(valid, data.scaling.unscale_y(data.samples.y), np.nan)
    return from_model_units(data.transform, measured), from_model_units(data.transform, predicted)


def liveliest(measured: FloatArray, judged: np.ndarray, scored: np.ndarray) -> tuple[int, int]:
    """Return first and stop row of a lively excerpt.

    All excerpts of unbroken stretches are sorted by the variation of their judged samples; the one
    at the 75th percentile is taken.
    """
    places = []
    for a, b in runs(scored):
        length = min(EXCERPT, b - a)
        for at in range(a, b - length + 1, max(length // 2, 1)):
            rows = slice(at, at + length)
            share = float(judged[rows].mean())
            spread = float(measured[rows][judged[rows]].std()) if share > 0 else 0.0
            places.append((length * share * spread, at, at + length))
    if not places:
        return 0, 0
    places.sort()
    return places[(3 * len(places)) // 4][1:]


def _residual(data: Prepared, predicted: FloatArray, rows: np.ndarray) -> FloatArray:
    """Return the residual (n,), NaN where the monitor would not judge it."""
    measured, run = in_units(data, predicted)
    judged = rows & data.enabled if (rows & data.enabled).sum() > WINDOW else rows
    return np.where(judged, measured - run, np.nan)


def _span(data: Prepared, predicted: FloatArray, rows: np.ndarray) -> float:
    residual = _residual(data, predicted, rows)
    known = np.abs(residual[np.isfinite(residual)])
    return float(5.0 * np.quantile(known, 0.99)) if len(known) else 1.0


def _residuals(
    data: Prepared, predicted: FloatArray, rows: np.ndarray, span: float, j: Mapping[str, float]
) -> dict[str, Any]:
    """Return the distribution of the residual and the paper's rule on its windows.

    span : half range of the histogram, in the output's unit
    j : limits ``j_mu`` and ``j_sigma`` of the paper's rule
    """
    residual = _residual(data, predicted, rows)
    known = residual[np.isfinite(residual)]
    edges = np.linspace(-span, span, BINS + 1)
    counts = np.histogram(np.clip(known, -span, span), edges)[0]
    windows = np.array(
        [
            [w.mean(), w.std()]
            for s in data.segments
            for a, b in runs(np.isfinite(residual[s.start : s.stop]))
            for w in np.split(
                residual[s.start + a : s.start + a + WINDOW * ((b - a) // WINDOW)],
                max((b - a) // WINDOW, 1),
            )
            if len(w) == WINDOW
        ]
    ).reshape(-1, 2)
    mean = np.abs(windows[:, 0]) >= j.get("j_mu", np.inf)
    std = windows[:, 1] >= j.get("j_sigma", np.inf)
    n = max(len(windows), 1)
    return {
        "samples": len(known),
        "share": counts / max(len(known), 1),
        "mean": known.mean() if len(known) else None,
        "std": known.std() if len(known) else None,
        "windows": len(windows),
        "beyond": {"mean": mean.sum() / n, "std": std.sum() / n, "both": (mean & std).sum() / n},
        "window_mean": thinned(windows[:, 0], 200),
        "window_std": thinned(windows[:, 1], 200),
    }


def _faults(
    task: Task,
    spec: Spec,
    weights: FloatArray,
    healthy: Prepared,
    span: float,
    j: Mapping[str, float],
) -> list[dict[str, Any]]:
    """Return residuals under faults: of faulty recordings, else of faults put on healthy ones."""
    found = []
    for recording in filter(partial(_readable, task), task.faulty):
        one = scaled_as(task.data, [recording])
        run = one.scaling.unscale_y(free_run(one, spec, weights))
        every = np.ones(len(run), dtype=bool)
        name, how = _named(recording)
        view = _view(one, run, every, name, source([recording]))
        found.append(
            {"name": name, "how": how, **_residuals(one, run, every, span, j), "view": view}
        )
    if task.faulty:
        return found
    predicted = healthy.scaling.unscale_y(free_run(healthy, spec, weights))
    phi = task.data.transform == "phi"
    for name in PUT_ON if phi else ANY_OUTPUT:
        measured = _put_on(name, healthy, phi=phi)
        one = replace(healthy, samples=replace(healthy.samples, y=measured))
        test = healthy.role == Role.TEST
        fault = resolve(name)
        title = f"{name} {fault.severity:g}{'' if name == 'gain_low' else ' s'}"
        if name.startswith("biased"):
            title = f"{name} {fault.severity:g}"
        view = _view(one, predicted, test, title, source(healthy.recordings))
        found.append(
            {
                "name": title,
                "how": "put on afterwards",
                **_residuals(one, predicted, test, span, j),
                "view": view,
            }
        )
    return found


def _readable(task: Task, recording: Recording) -> bool:
    """Return whether the output has any value; a missing signal has none."""
    return bool(np.isfinite(recording.column(task.output)).any())


def _named(recording: Recording) -> tuple[str, str]:
    """Return the fault of a faulty recording and its origin, from the manifest if it has one."""
    path = Path(recording.path)
    entry = manifest.load(path.parent).get(path.name, {})
    if entry.get("sha256") != recording.sha256 or not entry.get("fault"):
        return path.name, "as recorded"
    severity = entry.get("severity")
    name = f"{entry['fault']} {severity:g}" if severity is not None else str(entry["fault"])
    where = "in the control loop" if entry.get("in_the_loop") else "put on afterwards"
    return name, f"{where}, {entry.get('source', 'recorded')}"


def _put_on(name: str, data: Prepared, *, phi: bool) -> FloatArray:
    """Return the scaled output (n,) that a faulty sensor would read.

    Faults are defined on phi. Lag and dead time commute with an offset, so for another output they
    act on the output shifted into the range of phi.
    Raises UsageError if the result is not finite.
    """
    fault, period_s = resolve(name), data.period_ns / 1e9
    y = data.scaling.unscale_y(data.samples.y)
    shift = 0.0 if phi else 1.0 - float(y.min())
    result = np.empty(len(y))
    for s in data.segments:
        sensor = SensorFault(fault, period_s)
        own = y[s.start : s.stop] + shift
        lam = 1.0 / np.maximum(own, 1.0 / 16.0) if phi else 1.0 / own
        read = np.array(sensor.apply(lam.tolist()))
        result[s.start : s.stop] = 1.0 / read - shift
    if not np.isfinite(result).all():
        raise UsageError(f"fault {name} cannot be put on this output")
    return data.scaling.scale_y(result)
