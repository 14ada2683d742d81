"""Part 7 of the study: a model trained at steady operating points, used on transient driving.

*Model Based Diagnosis of Oxygen Sensors* trains at steady points and predicts drive cycles. Here
the paper's structure is trained twice, by the same recipe and on equally many samples: once on
steady driving and once on all driving. Both models run freely on the same transient drives.
"""

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from monitor.base.errors import RecordingError
from training.jobs.json_tree import plain
from training.narx.model_file import measures
from training.narx.network import Spec
from training.narx.stages import Trained, free_run, train
from training.recordings.preparation import Prepared, Role, prepare
from training.recordings.recording import Recording
from training.study.narx.models import thin
from training.study.outcome.sensor import in_units, liveliest
from training.study.task import LAGS, Task, as_in_use, scaled_as, source

HIDDEN = (8, 8)  # of the paper
WINDOW_S = 5.0  # length of a steady window
STEADY_CHANGE = 0.1  # largest change in a window, of the 1 to 99 % range of speed and load
SPEEDS = ("engine_speed_rpm",)
LOADS = ("air_mass_mg", "manifold_pressure_kpa", "engine_torque_nm")
FEWEST = 1500  # least training samples for a network of 400 weights
STARTS = 3
SHOWN = 500  # samples in the figure
BUDGET_SHARE = 0.1  # of the study's budget, for one of six trainings


def steady_against_mixed(task: Task) -> dict[str, Any]:
    """Return free-run errors on transient drives, after steady and after mixed training.

    Raises RecordingError if there are too few steady samples; the study then leaves this part out.
    """
    mixed_recordings = list(task.recordings)
    if not task.test:
        mixed_recordings = [_without_test(task, i) for i in range(len(task.recordings))]
    if task.steady:
        known = {r.sha256: r for r in mixed_recordings}  # without test blocks
        steady_recordings = [known.get(r.sha256, r) for r in task.steady]
        rule = "the recordings given with --steady"
    else:
        steady_recordings, rule = _steady_parts(mixed_recordings, task.inputs)
    settings = task.settings
    mixed = prepare(mixed_recordings, task.inputs, task.output, lags=LAGS, seed=settings.seed)
    steady = prepare(steady_recordings, task.inputs, task.output, lags=LAGS, seed=settings.seed)
    counts = [int((d.role == Role.TRAIN).sum()) for d in (steady, mixed)]
    n = min(*counts, settings.n_samples)
    if n < FEWEST:
        raise RecordingError(
            f"{counts[0]} training samples of steady operation ({rule}), {FEWEST} are wanted"
        )
    names = {"steady": (steady, steady_recordings), "mixed": (mixed, mixed_recordings)}
    few = [replace(thin(data, n), recordings=tuple(own)) for data, own in names.values()]
    trained = dict(zip(names, _trained(task, few), strict=True))
    return _result(task, rule, n, trained)


Model = tuple[Prepared, Spec, Trained]


def _trained(task: Task, prepared: Sequence[Prepared]) -> list[Model]:
    """Return the best start of every data set."""
    specs = [Spec(len(task.inputs), LAGS, HIDDEN, 1, *d.scaling.y_scaled_limits) for d in prepared]
    starts = range(min(STARTS, task.settings.starts))
    jobs = [(data, spec, i) for data, spec in zip(prepared, specs, strict=True) for i in starts]
    share_s = 60.0 * task.settings.budget_minutes * BUDGET_SHARE

    def one(job: tuple[Prepared, Spec, int]) -> Trained:
        data, spec, start = job
        return train(data, spec, task.settings.seed + 1000 * start, time.monotonic() + share_s)

    with ThreadPoolExecutor(task.jobs) as pool:
        found = list(pool.map(one, jobs))
    per = len(starts)
    best = [min(found[i * per : (i + 1) * per], key=lambda t: t.score) for i in range(len(specs))]
    return list(zip(prepared, specs, best, strict=True))


def _result(task: Task, rule: str, n: int, trained: dict[str, Model]) -> dict[str, Any]:
    models: dict[str, Any] = {}
    shown: dict[str, Any] = {}
    for name, (data, spec, best) in trained.items():
        held = _transient(task, data)
        run = held.scaling.unscale_y(free_run(held, spec, best.weights))
        test = held.role == Role.TEST
        measured, predicted = in_units(held, run)
        scored = test & np.isfinite(measured) & np.isfinite(predicted)
        first, stop = liveliest(measured, scored & held.enabled, scored)
        models[name] = {
            "all": measures(held, run, test),
            "enabled": measures(held, run, test & held.enabled),
            "own_validation_rmse": best.score * data.scaling.y_std,
            "samples": int((data.role == Role.TRAIN).sum()),
            "source": source(data.recordings),
            "cut": not best.stages or best.stages[-1].stop == "budget",
            "outside": _outside(data, held, test),
        }
        stop = min(stop, first + SHOWN)
        shown["judged"] = (scored & held.enabled)[first:stop].astype(int)
        shown["measured"] = measured[first:stop]
        shown[name] = predicted[first:stop]
        shown["first_s"] = first * held.period_ns / 1e9
    return plain(
        {
            "rule": rule,
            "training_samples": n,
            "models": models,
            "example": shown,
            "period_s": task.data.period_ns / 1e9,
            "output": task.output,
            "unit": task.data.output.unit,
            "test": "held-out recordings" if task.test else "test blocks of the recordings",
            "test_source": source(task.test or task.recordings),
        }
    )


def _transient(task: Task, data: Prepared) -> Prepared:
    """Return the transient test samples in the scaling of ``data``."""
    if task.test:
        return scaled_as(data, task.test)
    whole = scaled_as(data, task.recordings)
    return replace(whole, role=as_in_use(task.data).role)


def _outside(data: Prepared, held: Prepared, test: np.ndarray) -> float:
    """Return the share of test samples with an input at or outside the trained range."""
    s = data.scaling
    low, high = ((edge - s.u_mean) / s.u_std for edge in (s.u_low, s.u_high))
    u = held.samples.u[test]
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


def _steady_parts(
    recordings: Sequence[Recording], inputs: Sequence[str]
) -> tuple[list[Recording], str]:
    """Return the recordings with all but steady driving set to NaN, and the rule in words."""
    names = _operating_point(recordings, inputs)
    ranges = {}
    for name in names:
        low, high = np.nanpercentile(np.concatenate([r.column(name) for r in recordings]), [1, 99])
        ranges[name] = max(float(high - low), 1e-12)
    result = []
    for r in recordings:
        width = max(2, round(WINDOW_S * 1e9 / r.period_ns))
        on = np.zeros(len(r.t_s), dtype=bool)
        if len(r.t_s) > width:
            calm = np.ones(len(r.t_s) - width + 1, dtype=bool)
            for name in names:
                view = np.lib.stride_tricks.sliding_window_view(r.column(name), width)
                calm &= np.ptp(view, axis=1) <= STEADY_CHANGE * ranges[name]  # NaN is not calm
            for first in np.flatnonzero(calm):
                on[first : first + width] = True
        values = np.where(on[:, None], r.values, np.nan)
        result.append(replace(r, values=values))
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
