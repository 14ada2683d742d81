"""The chosen model against the sensor: residuals on healthy and faulty drives.

The results correspond to figures 6 and 7 of *Model Based Diagnosis of Oxygen Sensors*. Residuals
are measured minus predicted, in the output's unit, on samples that the monitor would judge.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.faults import resolve
from monitor.base.runs import runs
from monitor.base.types import FloatArray
from training.jobs.json_tree import json_tree
from training.recordings.recording import Recording
from training.recordings.samples.preparation import Role
from training.recordings.sensor_fault import put_on
from training.study.choice import chosen
from training.study.free_runs import WINDOW, FreeRun, scaled_as, trained_on
from training.study.narx.verdicts import ROLES
from training.study.task import Parts, Task, source

BINS = 80  # of the residual's distribution
PUT_ON = (
    *("slow_symmetric", "delay_rich_to_lean", "delay_symmetric"),
    *("transient", "gain_low", "biased_lean"),
)
ANY_OUTPUT = ("slow_symmetric", "delay_symmetric")  # faults that need no zero point of the sensor


def against_sensor(task: Task, parts: Parts) -> dict[str, Any]:
    """Return free runs and residuals on blocks and drives, healthy and faulty."""
    model, limits = chosen(task, parts), parts["shipped"]["limits"]
    network = (model.spec, model.weights)
    own = FreeRun.of(trained_on(task, task.data), *network)
    views = [
        replace(own, rows=own.data.role == role).view(f"{name} blocks", source(task.recordings))
        for role, name in zip(Role, ROLES.values(), strict=True)
    ]
    views += [
        FreeRun.of(scaled_as(task.data, [r]), *network).view(Path(r.path).name, source([r]))
        for r in task.test
    ]
    healthy = FreeRun.of(scaled_as(task.data, task.test), *network) if task.test else own
    known = np.abs(healthy.residual[np.isfinite(healthy.residual)])
    span = float(5.0 * np.quantile(known, 0.99)) if len(known) else 1.0
    edges = np.linspace(-span, span, BINS + 1)
    j = {k: limits[k]["value"] for k in ("j_mu", "j_sigma") if k in limits}
    faulty, unreadable = [] if task.faulty else [*_put_on_all(healthy)], []
    for r in task.faulty:
        try:
            faulty.append((FreeRun.of(scaled_as(task.data, [r]), *network), *_named(r)))
        except RecordingError:
            unreadable.append(Path(r.path).name)
    faults = [
        {"name": name, "how": how, "view": run.view(name, source(run.data.recordings))}
        | residuals(run, edges, j)
        for run, name, how in faulty
    ]
    return json_tree(
        {
            "output": task.output,
            "unit": task.data.output.unit,
            "period_s": task.period_s,
            "healthy_source": source(task.test or task.recordings),
            "healthy_on": "held-out recordings" if task.test else "test blocks",
            "views": views,
            "limits": j,
            "edges": edges,
            "healthy": residuals(healthy, edges, j),
            "unreadable": unreadable,
            "faults": faults,
        }
    )


def residuals(run: FreeRun, edges: FloatArray, j: Mapping[str, float]) -> dict[str, Any]:
    """Return the distribution of the residual and the paper's rule on its windows.

    edges : of the histogram's bins, in the output's unit
    j : limits ``j_mu`` and ``j_sigma`` of the paper's rule
    """
    residual = run.residual
    known = residual[np.isfinite(residual)]
    parts = [residual[s.start : s.stop] for s in run.data.segments]
    unbroken = [part[a:b] for part in parts for a, b in runs(np.isfinite(part))]
    windows = [p[i : i + WINDOW] for p in unbroken for i in range(0, len(p) - WINDOW + 1, WINDOW)]
    means, stds = (np.array([f(w) for w in windows]) for f in (np.mean, np.std))
    mean = np.abs(means) >= j.get("j_mu", np.inf)
    std = stds >= j.get("j_sigma", np.inf)
    n = max(len(windows), 1)
    return {
        "samples": len(known),
        "share": np.histogram(np.clip(known, edges[0], edges[-1]), edges)[0] / max(len(known), 1),
        "mean": known.mean() if len(known) else None,
        "std": known.std() if len(known) else None,
        "windows": len(windows),
        "beyond": {"mean": mean.sum() / n, "std": std.sum() / n, "both": (mean & std).sum() / n},
    }


def _named(recording: Recording) -> tuple[str, str]:
    """Return the fault of a faulty recording and its origin, from the manifest if it has one."""
    entry = recording.entry
    if not entry.get("fault"):
        return recording.path.name, "as recorded"
    severity = entry.get("severity")
    name = f"{entry['fault']} {severity:g}" if severity is not None else str(entry["fault"])
    where = "in the control loop" if entry.get("in_the_loop") else "put on afterwards"
    return name, f"{where}, {entry.get('source', 'recorded')}"


def _put_on_all(healthy: FreeRun) -> Iterator[tuple[FreeRun, str, str]]:
    """Yield the healthy run with each fault on its measurement, the fault's name, and how."""
    data = healthy.data
    for name in PUT_ON if data.transform == "phi" else ANY_OUTPUT:
        fault, unit = resolve(name), "" if name.startswith(("gain", "biased")) else " s"
        drives = [put_on(r, fault, data.output.name, data.transform) for r in data.recordings]
        faulty = replace(scaled_as(data, drives), role=data.role)
        yield replace(healthy, data=faulty), f"{name} {fault.severity:g}{unit}", "put on afterwards"
