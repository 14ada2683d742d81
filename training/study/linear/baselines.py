"""Linear study: impulse responses, ARX, state space and output error models, residual tests."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from monitor.base.errors import RecordingError, UsageError
from monitor.base.types import FloatArray
from training.jobs.json_tree import plain
from training.narx.linear.arx import (
    FREE_RUN_DELAYS,
    GRID_DELAYS,
    MAX_ORDER,
    Arx,
    arx_delays,
    best_in_free_run,
    common_delays,
    order_grid,
    solve_arx,
)
from training.narx.linear.free_run import LinearModel, free_runs
from training.narx.linear.regressors import (
    Stretch,
    Triangle,
    checked,
    largest_order,
    triangle,
)
from training.recordings.metrics import correlation, fit_percent, rmse
from training.study.free_runs import liveliest
from training.study.linear.output_error import fit_output_error
from training.study.linear.responses import BAND, impulse_response, independence, whiteness
from training.study.linear.subspace import StateSpace, best_state_space, subspace

MAX_STATES = 12
LEAST_ORDER = 2
IMPULSE_LAGS = 50  # samples
EXAMPLE = 600  # samples of the excerpt
FREE_RUN = ("validation_rmse", "validation_fit_percent", "fit_percent", "correlation", "rmse")
SHOWN = ("arx_free_run", "subspace", "output_error")  # models in the excerpt


@dataclass(frozen=True, slots=True)
class Regime:
    """A signal, usually engine speed; fits on the test stretches are split by its ranges."""

    name: str
    unit: str
    values: Sequence[FloatArray]  # (n,) per test stretch


@dataclass(frozen=True, slots=True)
class Case:
    """What the linear models are fitted to."""

    train: Sequence[Stretch]
    validate: Sequence[Stretch]
    order: int  # largest
    skip: int  # first samples of a stretch that set the state and are not scored
    data: Triangle  # condensed training stretches
    delays: tuple[int, ...]  # dead time of each input


def linear(
    train: Sequence[Stretch],
    validate: Sequence[Stretch],
    test: Sequence[Stretch],
    inputs: Sequence[str],
    output: str,
    *,
    period_s: float,
    unit: str = "",
    regime: Regime | None = None,
    max_order: int = MAX_ORDER,
) -> dict[str, Any]:
    """Return the linear study of one output.

    train, validate, test : stretches (u (n, k), y (n,)) without gaps; models are fitted on
        ``train``, orders chosen on ``validate``, fits in percent taken on ``test``
    unit : unit of the output, for the axes
    regime : signal by whose ranges the fits are split
    max_order : largest order of the ARX models; few samples and short stretches lower it
    The first samples of a stretch (``skip`` in the result, twice the order) set the state of every
    model and are not scored. Stretches shorter than twice ``skip`` are left out.
    Raises RecordingError for values that are not finite, wrong shapes or too few samples, and
    UsageError for a regime that does not fit the test stretches.
    """
    roles = {"training": train, "validation": validate, "test": test}
    order = largest_order(checked(train, inputs, "training"), max_order)
    longest = min(max((len(y) for _, y in each), default=0) for each in roles.values())
    order = min(order, max(LEAST_ORDER, longest // 4))
    skip = 2 * order
    usable = {role: _usable(each, inputs, role, skip) for role, each in roles.items()}
    learn, choose, judge = ([s for _, s in usable[role]] for role in roles)
    ranges, masks = _ranges(regime, test, [index for index, _ in usable["test"]], skip)
    data = triangle(learn, skip, skip)
    case = Case(learn, choose, order, skip, data, arx_delays(data, order))
    models, arx = _arx_models(case)
    states, models["subspace"], space = _state_space(case)
    models["output_error"], error = _output_error(case, states, models["arx_free_run"])
    fits = {name: _scores(m, case, judge, masks) for name, m in models.items()}
    best = min((n for n in fits if fits[n]["stable"]), key=lambda n: fits[n]["validation_rmse"])
    counts = [int(m.sum()) for m in masks]
    stored: dict[str, Any] = plain(
        {
            "schema": "o2train.study.linear/1",
            "inputs": inputs,
            "output": output,
            "unit": unit,
            "period_s": period_s,
            "samples": {role: sum(len(y) for _, (_, y) in each) for role, each in usable.items()},
            "stretches": {role: [len(each), len(roles[role])] for role, each in usable.items()},
            "skip": skip,
            "largest_order": order,
            "impulse": _impulse(case, inputs),
            "arx": arx,
            "subspace": space,
            "output_error": error,
            "models": fits,
            "best": best,
            "regime": regime
            and {"name": regime.name, "unit": regime.unit, "ranges": ranges, "samples": counts},
            "residuals": _residuals(models, judge, inputs, skip),
            "example": _example({n: models[n] for n in SHOWN}, judge, period_s, skip),
        }
    )
    free = models["arx_free_run"]
    assert isinstance(free, Arx)
    stored["arx"]["free_run_model"] = {  # a free run needs all digits
        "a": free.a.tolist(),
        "b": free.b.tolist(),
        "delays": list(free.delays),
        "offset": free.offset,
    }
    return stored


def _usable(
    stretches: Sequence[Stretch], inputs: Sequence[str], role: str, skip: int
) -> list[tuple[int, Stretch]]:
    """Return the stretches of at least twice ``skip`` samples, with their indices."""
    every = checked(stretches, inputs, role)
    kept = [(i, s) for i, s in enumerate(every) if len(s[1]) >= 2 * skip]
    if kept and np.ptp(np.concatenate([y for _, (_, y) in kept])) == 0.0:
        raise RecordingError(f"{role}: the output is constant ({kept[0][1][1][0]:g})")
    if not kept:
        longest = max(len(y) for _, y in every)
        raise RecordingError(
            f"{role}: the longest stretch has {longest} samples, {2 * skip} are wanted"
        )
    return kept


def _ranges(
    regime: Regime | None, test: Sequence[Stretch], indices: Sequence[int], skip: int
) -> tuple[list[tuple[float, float]], list[np.ndarray]]:
    """Return thirds of the regime's values, with masks (n,) of the scored rows in them."""
    if regime is None:
        return [], []
    for index, (values, (_, y)) in enumerate(zip(regime.values, test, strict=False)):
        if np.shape(values) != y.shape:
            raise UsageError(
                f"{regime.name}: {np.shape(values)} values for test stretch {index} of {y.shape}"
            )
    if len(regime.values) != len(test):
        raise UsageError(f"{regime.name}: of {len(regime.values)} stretches, wanted {len(test)}")
    scored = np.concatenate([np.asarray(regime.values[i], dtype=float)[skip:] for i in indices])
    edges = np.unique(np.nanquantile(scored, [1 / 3, 2 / 3])).tolist()
    ranges = list(pairwise([-np.inf, *edges, np.inf]))
    return ranges, [(scored >= low) & (scored < high) for low, high in ranges]


def _arx_models(case: Case) -> tuple[dict[str, LinearModel], dict[str, Any]]:
    """Return four ARX models, chosen by four criteria, and the figures of the grid of orders."""
    data, order, inputs = case.data, case.order, case.data.n_inputs
    held_out = triangle(case.validate, case.skip, case.skip)
    delays = common_delays(inputs, min(GRID_DELAYS, order), case.delays)
    grid = order_grid(data, held_out, order, delays)
    least = {"arx_sum_of_squares": "validation_loss", "arx_mdl": "mdl", "arx_aic": "aic"}
    arx: dict[str, Arx] = {}
    for name, criterion in least.items():
        found = min(grid, key=lambda c: getattr(c, criterion))
        arx[name] = solve_arx(data, found.na, found.nb, found.delays)
    few = common_delays(inputs, min(FREE_RUN_DELAYS, order), case.delays)
    arx["arx_free_run"] = best_in_free_run(data, case.validate, order, few)
    counts = sorted({c.n_parameters for c in grid})
    envelope = {
        key: [min(getattr(c, key) for c in grid if c.n_parameters == d) for d in counts]
        for key in ("loss", "validation_loss", "aic", "mdl")
    }
    orders = {n: {"na": len(m.a), "nb": m.b.shape[1], "nk": m.delays} for n, m in arx.items()}
    shown = {"candidates": len(grid), "choices": orders, "parameters": counts}
    return dict(arx), shown | envelope


def _state_space(case: Case) -> tuple[Sequence[StateSpace], LinearModel, dict[str, Any]]:
    """Return the models of all orders, the best in free run, and the figures."""
    past = case.skip
    found = subspace(case.data, past, min(MAX_STATES, past - 1))
    best, errors = best_state_space(found, case.validate, case.skip)
    return (
        found.models,
        best,
        {
            "past": past,
            "singular_values": found.singular_values,
            "order": best.order,
            "order_by_gap": found.order_by_gap,
            "validation_rmse": np.sqrt(errors),
        },
    )


def _output_error(
    case: Case, states: Sequence[StateSpace], free: LinearModel
) -> tuple[LinearModel, dict[str, Any]]:
    """Return the best output error model from many starts, and the figures of all starts."""
    data, none, wide = case.data, (0,) * case.data.n_inputs, min(12, case.order)
    starts = [("subspace", m.transfer()) for m in states[:8]]
    shapes = [(n, n, case.delays) for n in (1, 2, 3)] + [(n, wide, none) for n in (1, 2, 4, 6)]
    starts += [("ARX", solve_arx(data, *shape)) for shape in shapes if shape[0] <= case.order]
    if isinstance(free, Arx) and 1 <= len(free.a) <= MAX_STATES:
        starts.append(("ARX, free run", free))
    starts = [(name, m) for name, m in starts if m.lags + len(m.a) <= case.skip]
    best, tried = fit_output_error(case.train, case.validate, [m for _, m in starts], case.skip)
    rows = [
        {"start": name, **_shape(m)}
        | {"training_rmse": np.sqrt(cost), "validation_rmse": np.sqrt(error)}
        for (name, _), (m, cost, error) in zip(starts, tried, strict=True)
    ]
    return best, {**_shape(best.transfer), "starts": rows}


def _shape(model: Arx) -> dict[str, Any]:
    return {"nf": len(model.a), "nb": model.b.shape[1], "nk": model.delays}


def _impulse(case: Case, inputs: Sequence[str]) -> dict[str, Any]:
    samples = sum(len(y) for _, y in case.train)
    lags = max(5, min(IMPULSE_LAGS, samples // (20 * len(inputs))))
    found = impulse_response(case.train, lags)
    rows = [
        {
            "input": name,
            "response": found.response[i],
            "band": BAND * found.standard_error[i],
            "joint_band": found.joint_band[i],
            "delay": found.delays()[i],
            "arx_delay": case.delays[i],
            "effective_samples": found.effective_samples[i],
        }
        for i, name in enumerate(inputs)
    ]
    left = float(np.abs(found.white[1:]).max())
    return {"rows": rows, "largest_arx_delay": case.order, "largest_autocorrelation_left": left}


def _scores(
    model: LinearModel, case: Case, test: Sequence[Stretch], masks: Sequence[np.ndarray]
) -> dict[str, Any]:
    """Return the fits of free run and one-step prediction; free-run fits are None if unstable."""
    skip = case.skip
    y = _scored([y for _, y in test], skip)
    known = {
        "parameters": model.n_parameters,
        "stable": model.stable,
        "one_step_fit_percent": fit(y, _scored([model.predict(u, y) for u, y in test], skip)),
    }
    if not model.stable:
        lists = {"stretch_fit_percent": len(test), "regime_fit_percent": len(masks)}
        return known | dict.fromkeys(FREE_RUN) | {k: [None] * n for k, n in lists.items()}
    free = free_runs(model, test, skip)
    run = _scored(free, skip)
    held_out = _scored([y for _, y in case.validate], skip)
    held_out_run = _scored(free_runs(model, case.validate, skip), skip)
    return known | {
        "validation_rmse": rmse(held_out, held_out_run),
        "validation_fit_percent": fit(held_out, held_out_run),
        "rmse": rmse(y, run),
        **fits(y, run, masks),
        "stretch_fit_percent": [
            fit(y[skip:], run[skip:]) for (_, y), run in zip(test, free, strict=True)
        ],
    }


def _scored(series: Sequence[FloatArray], skip: int) -> FloatArray:
    return np.concatenate([each[skip:] for each in series])


def fits(y: FloatArray, run: FloatArray, masks: Sequence[np.ndarray]) -> dict[str, Any]:
    """Return fit and correlation of a free run (n,), and the fit in each mask (n,)."""
    return {
        "fit_percent": fit(y, run),
        "correlation": correlation(y, run),
        "regime_fit_percent": [fit(y[m], run[m]) for m in masks],
    }


def fit(measured: FloatArray, simulated: FloatArray) -> float | None:
    """Return the fit in percent, None where there is nothing to fit."""
    if len(measured) < 2 or np.ptp(measured) == 0.0 or not np.isfinite(simulated).all():
        return None
    return fit_percent(measured, simulated)


def _residuals(
    models: Mapping[str, LinearModel], test: Sequence[Stretch], inputs: Sequence[str], skip: int
) -> dict[str, Any]:
    """Return the residual tests of all models on the test stretches.

    The residuals are one-step residuals, for output error models simulation residuals.
    """
    driven = [u[skip:] for u, _ in test]
    result = {}
    for name, model in models.items():
        left = [y[skip:] - model.predict(u, y)[skip:] for u, y in test]
        if np.isfinite(np.concatenate(left)).all():  # the Kalman filter may be unstable
            tests = {
                "whiteness": whiteness(left),
                "independence": independence(left, driven, inputs),
            }
            result[name] = tests
    return result


def _example(
    models: Mapping[str, LinearModel], test: Sequence[Stretch], period_s: float, skip: int
) -> dict[str, Any]:
    """Return a lively excerpt of the test stretches with the free runs of the stable models."""
    length = min(EXAMPLE, min(len(y) for _, y in test) - skip)
    begins = np.cumsum([0, *(len(y) for _, y in test)])
    scored = np.concatenate([np.arange(len(y)) >= skip for _, y in test])
    first, _ = liveliest(np.concatenate([y for _, y in test]), scored, scored, length)
    index = int(np.searchsorted(begins, first, "right")) - 1
    (u, y), at = test[index], first - int(begins[index])
    rows = slice(at, at + length)
    return {
        "stretch": index,
        "time_s": (at + np.arange(length)) * period_s,
        "measured": y[rows],
        "runs": {n: m.simulate(u, y[:skip])[rows] for n, m in models.items() if m.stable},
    }
