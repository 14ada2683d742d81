"""Linear models on the study's recordings, and the NARX on the same samples."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from monitor.base.types import FloatArray
from training.jobs.json_tree import plain
from training.recordings.metrics import correlation
from training.recordings.recording import Recording
from training.recordings.samples.linear_data import LinearData, LinearStretch, linear_stretches
from training.recordings.samples.preparation import Role
from training.recordings.samples.rows import runs
from training.study.baselines import fit, linear
from training.study.choice import chosen
from training.study.free_runs import FreeRun, judged_on
from training.study.task import Parts, Task

Cut = tuple[Sequence[Recording], list[LinearStretch]]  # recordings and their filtered stretches


def baselines(task: Task, parts: Parts) -> dict[str, Any]:
    """Return the linear study, with the same training, validation and test samples as the NARX.

    A zero-phase filter removes the noise band that the preparation found.
    Raises RecordingError if the samples are too few.
    """
    band_hz = parts["preparation"]["band_hz"]
    prepared, cuts = _stretches(task, band_hz)

    def pairs(role: Role) -> list[tuple[FloatArray, FloatArray]]:
        recordings, stretches = cuts[role]
        z = [prepared.apply(p.values, p.t_s, recordings[p.recording].sha256) for p in stretches]
        return [(each[:, :-1], each[:, -1]) for each in z]

    result = linear(
        pairs(Role.TRAIN),
        pairs(Role.VALIDATE),
        pairs(Role.TEST),
        task.inputs,
        task.output,
        period_s=task.period_s,
        unit="z-scored",
    )
    return result | {"band_hz": band_hz}


def _stretches(task: Task, band_hz: Sequence[float] | None) -> tuple[LinearData, dict[Role, Cut]]:
    """Return the linear preparation, and the stretches by role."""
    whole, prepared = linear_stretches(task.recordings, task.inputs, task.output, band_hz)
    roles = [np.full(len(r.t_s), -1, dtype=np.int8) for r in task.recordings]
    for s in task.data.segments:
        roles[s.recording][s.first : s.first + s.stop - s.start] = task.data.role[s.start : s.stop]
    cuts: dict[Role, Cut] = {}
    for role in Role:
        found = [
            LinearStretch(p.recording, p.first + a, p.t_s[a:b], p.values[a:b])
            for p in whole
            for a, b in runs(roles[p.recording][p.first : p.first + len(p.t_s)] == role)
        ]
        cuts[role] = (task.recordings, found)
    if task.test:
        drives, _ = linear_stretches(task.test, task.inputs, task.output, reference=prepared)
        cuts[Role.TEST] = (task.test, drives)
    return prepared, cuts


def beside(task: Task, parts: Parts) -> dict[str, Any]:
    """Return the fits of the NARX and of the linear models on the same test samples.

    The NARX runs freely from the start of every recording. If the linear models use filtered data,
    the NARX's prediction and the measurement go through the same filter.
    """
    found = parts["linear"]
    if "skipped" in found:
        return {"skipped": "no linear baselines"}
    model, skip = chosen(task, parts), found["skip"]
    prepared, cuts = _stretches(task, found["band_hz"])
    recordings, stretches = cuts[Role.TEST]
    held = FreeRun.of(judged_on(task), model.spec, model.weights)
    rows = [np.full(len(r.t_s), np.nan) for r in recordings]
    for s in held.data.segments:
        rows[s.recording][s.first : s.first + s.stop - s.start] = held.predicted[s.start : s.stop]
    long = [p for p in stretches if len(p.t_s) >= 2 * skip]
    own = [_filtered(prepared, rows[p.recording][p.first : p.first + len(p.t_s)]) for p in long]
    y = np.concatenate([p.values[skip:, -1] for p in long])
    y_hat = np.concatenate([run[skip:] for run in own])
    good = np.isfinite(y_hat)
    y, y_hat = y[good], y_hat[good]
    shown = ("parameters", "fit_percent", "correlation")
    narx = (model.spec.n_weights, fit(y, y_hat), correlation(y, y_hat))
    return plain(
        {
            "narx": dict(zip(shown, narx, strict=True)),
            "models": {n: {k: m[k] for k in shown} for n, m in found["models"].items()},
            "samples": len(y),
            "best_linear": found["best"],
            "filtered": prepared.filter is not None,
        }
    )


def _filtered(prepared: LinearData, run: FloatArray) -> FloatArray:
    known = np.isfinite(run)
    if prepared.filter is None or not known.any():
        return run
    at = np.arange(len(run))
    whole = np.interp(at, at[known], run[known])
    return np.where(known, prepared.filter.apply(whole[:, None])[:, 0], np.nan)
