"""A model trained at steady operating points, used on transient driving.

*Model Based Diagnosis of Oxygen Sensors* trains at steady points and predicts drive cycles. Here
the paper's structure is trained twice, by the same recipe and on equally many samples: once on
steady driving and once on all driving. Both models run freely on the same transient drives.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from monitor.base.errors import RecordingError
from training.jobs.json_tree import plain
from training.narx.network import Spec
from training.recordings.recording import Recording
from training.recordings.samples.preparation import Prepared, Role, prepare
from training.study.free_runs import FreeRun, judged_on, liveliest
from training.study.narx.models import SEED_STEP, Start, thin, trained
from training.study.task import LAGS, Parts, Task, source

HIDDEN = (8, 8)  # of the paper
WINDOW_S = 5.0  # length of a steady window
STEADY_CHANGE = 0.1  # largest change in a window, of the 1 to 99 % range of speed and load
SPEEDS = ("engine_speed_rpm",)
LOADS = ("air_mass_mg", "manifold_pressure_kpa", "engine_torque_nm")
FEWEST = 1500  # least training samples for a network of 400 weights
STARTS = 3
SHOWN = 500  # samples in the figure
BUDGET_SHARE = 0.1  # of the study's budget, for one of six trainings


def steady_against_mixed(task: Task, _: Parts) -> dict[str, Any]:
    """Return free-run errors on transient drives, after steady and after mixed training.

    Raises RecordingError if there are too few steady samples; the study then leaves this part out.
    """
    mixed = list(task.recordings)
    if not task.test:
        mixed = [_without_test(task, i) for i in range(len(mixed))]
    if task.steady:
        known = {r.sha256: r for r in mixed}  # without test blocks
        steady = [known.get(r.sha256, r) for r in task.steady]
        rule = "the recordings given with --steady"
    else:
        steady, rule = steady_parts(mixed, task.inputs)
    settings, limit_s = task.settings, 60.0 * task.settings.budget_minutes * BUDGET_SHARE
    whole = [
        prepare(each, task.inputs, task.output, lags=LAGS, seed=settings.seed)
        for each in (steady, mixed)
    ]
    counts = [int((d.role == Role.TRAIN).sum()) for d in whole]
    n = min(*counts, settings.n_samples)
    if n < FEWEST:
        raise RecordingError(
            f"{counts[0]} training samples of steady operation ({rule}), {FEWEST} are wanted"
        )
    few = [
        replace(thin(data, n), recordings=tuple(own))
        for data, own in zip(whole, (steady, mixed), strict=True)
    ]
    specs = [Spec(len(task.inputs), LAGS, HIDDEN, 1, *d.scaling.y_scaled_limits) for d in few]
    per = min(STARTS, settings.starts)
    seeds = [settings.seed + SEED_STEP * i for i in range(per)]
    starts = [Start(i, spec, seed, limit_s) for i, spec in enumerate(specs) for seed in seeds]
    every = trained(few, starts, task.jobs)
    models, shown = {}, dict[str, Any]()
    for i, name in enumerate(("steady", "mixed")):
        best = min(every[i * per : (i + 1) * per], key=lambda t: t.score)
        run = FreeRun.of(judged_on(task, few[i]), specs[i], best.weights)
        models[name] = run.errors() | {
            "own_validation_rmse": best.score * few[i].scaling.y_std,
            "samples": int((few[i].role == Role.TRAIN).sum()),
            "source": source(few[i].recordings),
            "cut": not best.stages or best.stages[-1].stop == "budget",
            "outside": _outside(few[i], run),
        }
        measured, predicted = run.in_units
        judged = run.scored & run.data.enabled
        first, stop = liveliest(measured, judged, run.scored)
        rows = slice(first, min(stop, first + SHOWN))
        shown |= {
            "judged": judged[rows].astype(int),
            "measured": measured[rows],
            name: predicted[rows],
            "first_s": first * task.period_s,
        }
    return plain(
        {
            "rule": rule,
            "training_samples": n,
            "models": models,
            "example": shown,
            "period_s": task.period_s,
            "output": task.output,
            "unit": task.data.output.unit,
            "test": "held-out recordings" if task.test else "test blocks of the recordings",
            "test_source": source(task.test or task.recordings),
        }
    )


def _outside(data: Prepared, run: FreeRun) -> float:
    """Return the share of test samples with an input at or outside the trained range."""
    s = data.scaling
    low, high = ((edge - s.u_mean) / s.u_std for edge in (s.u_low, s.u_high))
    u = run.data.samples.u[run.rows]
    return float(((u <= low + 1e-9) | (u >= high - 1e-9)).any(axis=1).mean())


def _without_test(task: Task, index: int) -> Recording:
    """Return the recording with its test blocks set to NaN, so that no training uses them."""
    recording, data = task.recordings[index], task.data
    values = np.array(recording.values, dtype=np.float64)
    for s in data.segments:
        if s.recording == index:
            test = np.flatnonzero(data.role[s.start : s.stop] == Role.TEST)
            values[s.first + test] = np.nan
    return replace(recording, values=values)


def steady_parts(
    recordings: Sequence[Recording], inputs: Sequence[str]
) -> tuple[list[Recording], str]:
    """Return the recordings with all but steady driving set to NaN, and the rule in words."""
    names = _operating_point(recordings, inputs)
    together = [np.concatenate([r.column(name) for r in recordings]) for name in names]
    low, high = np.array([np.nanpercentile(values, [1, 99]) for values in together]).T
    largest = STEADY_CHANGE * np.maximum(high - low, 1e-12)
    result = []
    for r in recordings:
        width = max(2, round(WINDOW_S * 1e9 / r.period_ns))
        on = np.zeros(len(r.t_s), dtype=bool)
        if len(r.t_s) > width:
            values = np.column_stack([r.column(name) for name in names])
            change = np.ptp(sliding_window_view(values, width, axis=0), axis=-1)
            for first in np.flatnonzero((change <= largest).all(axis=1)):  # NaN is not calm
                on[first : first + width] = True
        result.append(replace(r, values=np.where(on[:, None], r.values, np.nan)))
    text = (
        f"stretches in which {' and '.join(names)} change by at most {100 * STEADY_CHANGE:g} % of "
        f"their range within {WINDOW_S:g} s"
    )
    return result, text


def _operating_point(recordings: Sequence[Recording], inputs: Sequence[str]) -> list[str]:
    """Return the names of speed and load, or all inputs if the names are not recognised."""
    common = [n for n in recordings[0].names if all(n in r.names for r in recordings)]
    speed = [n for n in SPEEDS if n in common] or [n for n in inputs if "speed" in n]
    load = [n for n in LOADS if n in common] or [n for n in inputs if "load" in n]
    return [speed[0], load[0]] if speed and load else list(inputs)
