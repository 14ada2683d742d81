"""Linear study: impulse responses, ARX, state space and output error models, residual tests."""

from collections.abc import Sequence
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
    Candidate,
    arx_delays,
    best_in_free_run,
    common_delays,
    order_grid,
    solve_arx,
)
from training.narx.linear.free_run import LinearModel
from training.narx.linear.regressors import (
    Stretch,
    Triangle,
    checked,
    largest_order,
    triangle,
)
from training.study.linear.impulse import impulse_response
from training.study.linear.output_error import fit_output_error
from training.study.linear.scores import example, residuals, scores
from training.study.linear.subspace import Subspace, best_state_space, subspace

__all__ = ["Regime", "linear"]

MAX_STATES = 12
LEAST_ORDER = 2
IMPULSE_LAGS = 50  # samples


@dataclass(frozen=True, slots=True)
class Regime:
    """A signal, usually engine speed; fits on the test stretches are split by its ranges."""

    name: str
    unit: str
    values: Sequence[FloatArray]  # (n,) per test stretch
    edges: Sequence[float] | None = None  # inner edges of the ranges; None: thirds of the samples


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
    """Return the linear study of one output, ready for JSON and ``section``.

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
    ranges = _ranges(regime, test, [index for index, _ in usable["test"]], skip)
    data, held_out = triangle(learn, skip, skip), triangle(choose, skip, skip)
    delays = arx_delays(data, order)
    models, arx = _arx_models(data, held_out, choose, order, delays)
    states, state_result = _state_space(data, choose, order, skip)
    models["subspace"] = states.models[state_result["order"] - 1]
    models["output_error"], error_result = _output_error(
        data=data,
        train=learn,
        validate=choose,
        order=order,
        delays=delays,
        states=states,
        free=models["arx_free_run"],
        skip=skip,
    )
    fits = {name: scores(m, choose, judge, ranges, skip) for name, m in models.items()}
    best = min((n for n in fits if fits[n]["stable"]), key=lambda n: fits[n]["validation_rmse"])
    result = {
        "schema": "o2train.study.linear/1",
        "inputs": list(inputs),
        "output": output,
        "unit": unit,
        "period_s": period_s,
        "samples": {role: sum(len(y) for _, (_, y) in each) for role, each in usable.items()},
        "stretches": {role: [len(each), len(roles[role])] for role, each in usable.items()},
        "skip": skip,
        "largest_order": order,
        "impulse": _impulse(learn, inputs, delays, order),
        "arx": arx,
        "subspace": state_result,
        "output_error": error_result,
        "models": fits,
        "best": best,
        "regime": None
        if regime is None
        else {
            "name": regime.name,
            "unit": regime.unit,
            "ranges": [r["range"] for r in ranges],
            "samples": [int(sum(m.sum() for m in r["rows"])) for r in ranges],
        },
        "residuals": residuals(models, judge, inputs, skip),
        "example": example(models, fits, judge, period_s, skip),
    }
    stored = plain(result)
    stored["arx"]["free_run_model"] = _exactly(models["arx_free_run"])
    return stored


def _exactly(model: LinearModel) -> dict[str, Any]:
    """Return the coefficients of an ARX model in full precision; a free run needs all digits."""
    assert isinstance(model, Arx)
    return {
        "a": model.a.tolist(),
        "b": model.b.tolist(),
        "delays": list(model.delays),
        "offset": model.offset,
    }


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
) -> list[dict[str, Any]]:
    """Return the regime's ranges with masks of the scored rows, one per usable test stretch."""
    if regime is None:
        return []
    for index, (values, (_, y)) in enumerate(zip(regime.values, test, strict=False)):
        if np.shape(values) != y.shape:
            raise UsageError(
                f"{regime.name}: {np.shape(values)} values for test stretch {index} of {y.shape}"
            )
    if len(regime.values) != len(test):
        raise UsageError(f"{regime.name}: of {len(regime.values)} stretches, wanted {len(test)}")
    scored = [np.asarray(regime.values[i], dtype=np.float64)[skip:] for i in indices]
    edges = regime.edges
    if edges is None:
        edges = np.unique(np.nanquantile(np.concatenate(scored), [1 / 3, 2 / 3])).tolist()
    borders = [-np.inf, *edges, np.inf]
    return [
        {"range": [low, high], "rows": [(v >= low) & (v < high) for v in scored]}
        for low, high in pairwise(borders)
    ]


def _arx_models(
    data: Triangle,
    held_out: Triangle,
    validate: Sequence[Stretch],
    order: int,
    delays: tuple[int, ...],
) -> tuple[dict[str, LinearModel], dict[str, Any]]:
    """Return four ARX models, chosen by four criteria, and the figures of the grid of orders."""
    grid = order_grid(
        data, held_out, order, common_delays(data.n_inputs, min(GRID_DELAYS, order), delays)
    )
    choices: dict[str, Candidate] = {
        "arx_sum_of_squares": min(grid, key=lambda c: c.validation_loss),
        "arx_mdl": min(grid, key=lambda c: c.mdl),
        "arx_aic": min(grid, key=lambda c: c.aic),
    }
    models: dict[str, LinearModel] = {
        name: solve_arx(data, c.na, c.nb, c.delays) for name, c in choices.items()
    }
    few = common_delays(data.n_inputs, min(FREE_RUN_DELAYS, order), delays)
    free = best_in_free_run(data, validate, order, few)
    models["arx_free_run"] = free
    counts = sorted({c.n_parameters for c in grid})
    envelope = {
        key: [min(getattr(c, key) for c in grid if c.n_parameters == d) for d in counts]
        for key in ("loss", "validation_loss", "aic", "mdl")
    }
    orders = {
        name: {"na": len(m.a), "nb": m.b.shape[1], "nk": m.delays}
        for name, m in models.items()
        if isinstance(m, Arx)
    }
    shown = {"candidates": len(grid), "choices": orders, "parameters": counts, **envelope}
    return models, shown


def _state_space(
    data: Triangle, validate: Sequence[Stretch], order: int, skip: int
) -> tuple[Subspace, dict[str, Any]]:
    past = skip
    found = subspace(data, past, min(MAX_STATES, past - 1))
    best, errors = best_state_space(found, validate, skip)
    return found, {
        "past": past,
        "singular_values": found.singular_values,
        "order": best.order,
        "order_by_gap": found.order_by_gap,
        "validation_rmse": [float(np.sqrt(e)) if np.isfinite(e) else None for e in errors],
    }


def _output_error(
    *,
    data: Triangle,
    train: Sequence[Stretch],
    validate: Sequence[Stretch],
    order: int,
    delays: tuple[int, ...],
    states: Subspace,
    free: LinearModel,
    skip: int,
) -> tuple[LinearModel, dict[str, Any]]:
    """Return the best output error model from many starts, and the figures of all starts."""
    none = (0,) * data.n_inputs
    starts = [("subspace", m.transfer()) for m in states.models[:8]]
    wide = min(12, order)
    shapes = [(n, n, delays) for n in (1, 2, 3)] + [(n, wide, none) for n in (1, 2, 4, 6)]
    starts += [("ARX", solve_arx(data, *shape)) for shape in shapes if shape[0] <= order]
    if isinstance(free, Arx) and 1 <= len(free.a) <= MAX_STATES:
        starts.append(("ARX, free run", free))
    starts = [(name, m) for name, m in starts if m.lags + len(m.a) <= skip]
    best, tried = fit_output_error(train, validate, [m for _, m in starts], skip)
    rows = [
        {
            "start": name,
            "nf": len(m.a),
            "nb": m.b.shape[1],
            "nk": m.delays,
            "training_rmse": np.sqrt(cost),
            "validation_rmse": np.sqrt(error),
        }
        for (name, _), (m, cost, error) in zip(starts, tried, strict=True)
    ]
    chosen = {"nf": len(best.transfer.a), "nb": best.transfer.b.shape[1]}
    return best, {**chosen, "nk": best.transfer.delays, "starts": rows}


def _impulse(
    train: Sequence[Stretch], inputs: Sequence[str], delays: tuple[int, ...], order: int
) -> dict[str, Any]:
    samples = sum(len(y) for _, y in train)
    found = impulse_response(train, max(5, min(IMPULSE_LAGS, samples // (20 * len(inputs)))))
    rows = [
        {
            "input": name,
            "response": found.response[i],
            "band": found.band * found.standard_error[i],
            "joint_band": found.joint_band * found.standard_error[i],
            "delay": found.delays()[i],
            "arx_delay": delays[i],
            "effective_samples": found.effective_samples[i],
        }
        for i, name in enumerate(inputs)
    ]
    remainder = float(np.abs(found.white[1:]).max())
    return {"rows": rows, "largest_arx_delay": order, "largest_autocorrelation_left": remainder}
