"""Linear study: impulse responses, ARX, state space and output error models, residual tests."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Final

import numpy as np

from monitor.base import counts
from monitor.base.errors import RecordingError
from monitor.base.runs import runs
from monitor.base.types import FloatArray
from training.jobs.json_tree import json_tree
from training.narx.linear import arx
from training.narx.linear.arx import Triangle, common_delays, largest_order, solve_arx, triangle
from training.narx.linear.models import LinearModel, Stretch, free_run_error, free_runs
from training.narx.linear.prediction_error import refine
from training.narx.linear.responses import band, impulse_response, independence, whiteness
from training.recordings.metrics import correlation, fit_percent, rmse
from training.recordings.recording import Recording
from training.recordings.samples.linear_data import LinearData, LinearStretch, linear_stretches
from training.recordings.samples.preparation import Role
from training.study.choice import chosen
from training.study.free_runs import FreeRun, judged_on
from training.study.task import Parts, Task

MAX_STATES = 12
LEAST_ORDER = 2
IMPULSE_LAGS = 50  # samples
CRITERIA = {"arx_sum_of_squares": "validation_loss", "arx_mdl": "mdl", "arx_aic": "aic"}

Cut = tuple[Sequence[Recording], list[LinearStretch]]  # recordings, filtered stretches


@dataclass(frozen=True, slots=True)
class BaselineCase:
    """What the linear models are fitted to and judged on."""

    train: Sequence[Stretch]
    validate: Sequence[Stretch]
    test: Sequence[Stretch]
    order: int  # largest
    skip: int  # first samples of a stretch that set the state and are not scored
    data: Triangle  # condensed training stretches
    delays: tuple[int, ...]  # dead time of each input

    def scored(self, series: Sequence[FloatArray]) -> FloatArray:
        """Return the scored samples of series, one per stretch, end to end."""
        return np.concatenate([each[self.skip :] for each in series])


def linear(
    train: Sequence[Stretch],
    validate: Sequence[Stretch],
    test: Sequence[Stretch],
    inputs: Sequence[str],
    output: str,
    *,
    period_s: float,
) -> dict[str, Any]:
    """Return the linear study of one output.

    train, validate, test : stretches (u (n, k), y (n,)) of finite samples; models are fitted on
        ``train``, orders chosen on ``validate``, fits in percent taken on ``test``
    The first samples of a stretch (``skip`` in the result, twice the order) set the state of every
    model and are not scored. Stretches shorter than twice ``skip`` are left out.
    Raises RecordingError for too few samples or a constant output.
    """
    roles = {"training": train, "validation": validate, "test": test}
    if not train:
        raise RecordingError("training: no stretch of samples, at least one is wanted")
    order = largest_order(train)
    longest = min(max((len(y) for _, y in each), default=0) for each in roles.values())
    order = min(order, max(LEAST_ORDER, longest // 4))
    skip = 2 * order
    usable = {role: _usable(each, role, skip) for role, each in roles.items()}
    data = triangle(usable["training"], skip, skip)
    learn, choose, judge = usable.values()
    case = BaselineCase(learn, choose, judge, order, skip, data, arx.arx_delays(data, order))
    models, candidates = _models(case)
    fits = {name: _scores(m, case) for name, m in models.items()}
    errors = {name: each["validation_rmse"] for name, each in fits.items() if each["stable"]}
    result = {
        "inputs": inputs,
        "output": output,
        "period_s": period_s,
        "samples": {role: sum(len(y) for _, y in each) for role, each in usable.items()},
        "stretches": {role: [len(usable[role]), len(roles[role])] for role in roles},
        "skip": skip,
        "largest_order": order,
        "impulse": _impulse(case, inputs),
        "candidates": candidates,
        "models": fits,
        "best": min(errors, key=errors.__getitem__),
        "residuals": _residuals(models, case, inputs),
    }
    return dict(json_tree(result))


def _usable(stretches: Sequence[Stretch], role: str, skip: int) -> list[Stretch]:
    """Return the stretches of at least twice ``skip`` samples."""
    kept = [s for s in stretches if len(s[1]) >= 2 * skip]
    if not kept:
        longest = max((len(y) for _, y in stretches), default=0)
        raise RecordingError(
            f"{role}: the longest stretch has {longest} samples, {2 * skip} are wanted"
        )
    if np.ptp(np.concatenate([y for _, y in kept])) == 0.0:
        raise RecordingError(f"{role}: the output is constant ({counts.plain(kept[0][1][0], 6)})")
    return kept


def _models(case: BaselineCase) -> tuple[dict[str, LinearModel], int]:
    """Return the chosen models by name, and the number of orders and dead times of ARX models.

    ARX by four criteria; state space of the best order and output error from the best start, both
    in free run.
    """
    data, order, none = case.data, case.order, (0,) * case.data.n_inputs
    grid_delays = common_delays(data.n_inputs, min(arx.GRID_DELAYS, order), case.delays)
    held_out = triangle(case.validate, case.skip, case.skip)
    grid = arx.order_grid(data, held_out, order, grid_delays)
    best = {n: min(grid, key=lambda c: getattr(c, key)) for n, key in CRITERIA.items()}
    models = {name: candidate.model for name, candidate in best.items()}
    free = arx.best_in_free_run(data, case.validate, order, case.delays)

    def error(model: LinearModel) -> float:
        return free_run_error(model, case.validate, case.skip)

    sizes = range(1, min(MAX_STATES, order) + 1)
    long = [solve_arx(data, n, n + 1, none) for n in sizes]
    states = [refine(each, case.train, case.skip, output_error=False) for each in long]
    shapes = [(n, n, case.delays) for n in (1, 2, 3)]
    shapes += [(n, min(12, order), none) for n in (1, 2, 4, 6)]
    starts = states[:8] + [solve_arx(data, *shape) for shape in shapes if shape[0] <= order]
    starts += [free] if len(free.a) in sizes else []
    simulated = [refine(start, case.train, case.skip) for start in starts]
    models |= {"arx_free_run": free, "state_space": min(states, key=error)}
    return models | {"output_error": min(simulated, key=error)}, len(grid)


def _impulse(case: BaselineCase, inputs: Sequence[str]) -> dict[str, Any]:
    samples = sum(len(y) for _, y in case.train)
    lags = max(5, min(IMPULSE_LAGS, samples // (20 * len(inputs))))
    found = impulse_response(case.train, lags)
    width, delays = band() * found.standard_error, found.delays()
    names = ("input", "response", "band", "delay", "arx_delay")
    rows = zip(inputs, found.response, width, delays, case.delays, strict=True)
    return {
        "rows": [dict(zip(names, row, strict=True)) for row in rows],
        "largest_arx_delay": case.order,
    }


def _scores(model: LinearModel, case: BaselineCase) -> dict[str, Any]:
    """Return orders, and fits of one step and free run; those of an unstable free run are None."""
    known: dict[str, Any] = {"parameters": model.n_parameters, "stable": model.stable}
    known |= {"na": len(model.a), "nb": model.b.shape[1], "nk": model.delays}
    one_step = case.scored([y - model.errors(u, y) for u, y in case.test])
    known["one_step_fit_percent"] = fit(case.scored([y for _, y in case.test]), one_step)
    for of, each in (("validation_", case.validate), ("", case.test)):
        measured = case.scored([y for _, y in each])
        run = case.scored(free_runs(model, each, case.skip)) if model.stable else None
        for name, measure in MEASURES.items():
            known[of + name] = None if run is None else measure(measured, run)
    return known


def fit(measured: FloatArray, simulated: FloatArray) -> float | None:
    """Return the fit in percent, None where there is nothing to fit."""
    if len(measured) < 2 or np.ptp(measured) == 0.0 or not np.isfinite(simulated).all():
        return None
    return fit_percent(measured, simulated)


MEASURES: Final = {"rmse": rmse, "fit_percent": fit, "correlation": correlation}


def _residuals(
    models: Mapping[str, LinearModel], case: BaselineCase, inputs: Sequence[str]
) -> dict[str, dict[str, Any]]:
    """Return the residual tests of all models on the test stretches.

    The residuals are one-step residuals, for output error models simulation residuals.
    """
    driven, result = case.scored([u for u, _ in case.test]), {}
    for name, model in models.items():
        left = case.scored([model.errors(u, y) for u, y in case.test])
        if np.isfinite(left).all():  # an unstable ARX's need not be
            tests = independence(left, driven, inputs)
            result[name] = {"whiteness": whiteness(left), "independence": tests}
    return result


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

    train, validate, test = map(pairs, Role)
    found = linear(train, validate, test, task.inputs, task.output, period_s=task.period_s)
    return found | {"band_hz": band_hz}


def _stretches(task: Task, band_hz: Sequence[float] | None) -> tuple[LinearData, dict[Role, Cut]]:
    """Return the linear preparation, and the stretches by role."""
    whole, prepared = linear_stretches(task.recordings, task.inputs, task.output, band_hz)
    roles = [np.full(len(r.t_s), -1, dtype=np.int8) for r in task.recordings]
    for s in task.data.segments:
        roles[s.recording][s.first : s.first + s.stop - s.start] = task.data.role[s.start : s.stop]
    cuts: dict[Role, Cut] = {role: (task.recordings, []) for role in Role}
    for p, role in product(whole, Role):
        for a, b in runs(roles[p.recording][p.first : p.first + len(p.t_s)] == role):
            part = LinearStretch(p.recording, p.first + a, p.t_s[a:b], p.values[a:b])
            cuts[role][1].append(part)
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
    held = FreeRun.of(judged_on(task, task.data), model.spec, model.weights)
    rows = [np.full(len(r.t_s), np.nan) for r in recordings]
    for s in held.data.segments:
        rows[s.recording][s.first : s.first + s.stop - s.start] = held.predicted[s.start : s.stop]
    long = [p for p in stretches if len(p.t_s) >= 2 * skip]
    own = [_filtered(prepared, rows[p.recording][p.first : p.first + len(p.t_s)]) for p in long]
    y = np.concatenate([p.values[skip:, -1] for p in long])
    y_hat = np.concatenate([run[skip:] for run in own])
    good = np.isfinite(y_hat)
    y, y_hat = y[good], y_hat[good]
    return json_tree(
        {
            "parameters": model.spec.n_weights,
            "fit_percent": fit(y, y_hat),
            "correlation": correlation(y, y_hat),
            "samples": len(y),
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
