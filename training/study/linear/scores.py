"""Scores of the linear models: fits, residual tests and an excerpt of the free run."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from monitor.base.types import FloatArray
from training.narx.linear.free_run import LinearModel, free_runs
from training.narx.linear.regressors import Stretch
from training.recordings.metrics import correlation, fit_percent, rmse
from training.study.linear.residual_tests import independence, whiteness

FIGURE_SAMPLES = 600  # length of the excerpt


def scores(
    model: LinearModel,
    validate: Sequence[Stretch],
    test: Sequence[Stretch],
    ranges: Sequence[Mapping[str, Any]],
    skip: int,
) -> dict[str, Any]:
    """Return the fits of free run and one-step prediction; free-run fits are None if unstable.

    ranges : ranges of the regime; ``rows`` of a range holds a mask of the scored rows per stretch
    skip : number of first samples of a stretch that set the state and are not scored
    """
    measured = [y[skip:] for _, y in test]
    one_step = np.concatenate([model.predict(u, y)[skip:] for u, y in test])
    y = np.concatenate(measured)
    known: dict[str, Any] = {"parameters": model.n_parameters, "stable": model.stable}
    known["one_step_fit_percent"] = _fit(y, one_step)
    if not model.stable:
        nothing = dict.fromkeys(("validation_rmse", "validation_fit_percent", "fit_percent"))
        nothing |= dict.fromkeys(("correlation", "rmse"))
        each = {"stretch_fit_percent": [None] * len(test)}
        return known | nothing | each | {"regime_fit_percent": [None] * len(ranges)}
    free = [run[skip:] for run in free_runs(model, test, skip)]
    run = np.concatenate(free)
    held_out = np.concatenate([y[skip:] for _, y in validate])
    held_out_run = np.concatenate([run[skip:] for run in free_runs(model, validate, skip)])
    rows = [np.concatenate(r["rows"]) for r in ranges]
    return known | {
        "validation_rmse": rmse(held_out, held_out_run),
        "validation_fit_percent": _fit(held_out, held_out_run),
        "fit_percent": _fit(y, run),
        "correlation": correlation(y, run),
        "rmse": rmse(y, run),
        "stretch_fit_percent": [_fit(a, b) for a, b in zip(measured, free, strict=True)],
        "regime_fit_percent": [_fit(y[r], run[r]) for r in rows],
    }


def _fit(measured: FloatArray, simulated: FloatArray) -> float | None:
    if len(measured) < 2 or np.ptp(measured) == 0.0 or not np.isfinite(simulated).all():
        return None
    return fit_percent(measured, simulated)


def residuals(
    models: Mapping[str, LinearModel],
    test: Sequence[Stretch],
    inputs: Sequence[str],
    skip: int,
) -> dict[str, Any]:
    """Return the residual tests of all models on the test stretches.

    The residuals are one-step residuals, for output error models simulation residuals.
    """
    driven = [u[skip:] for u, _ in test]
    result = {}
    for name, model in models.items():
        left = [y[skip:] - model.predict(u, y)[skip:] for u, y in test]
        if not np.isfinite(np.concatenate(left)).all():
            continue  # the Kalman filter of this state space model is unstable
        result[name] = {
            "whiteness": whiteness(left),
            "independence": independence(left, driven, inputs),
        }
    return result


def example(
    models: Mapping[str, LinearModel],
    fits: Mapping[str, Mapping[str, Any]],
    test: Sequence[Stretch],
    period_s: float,
    skip: int,
) -> dict[str, Any]:
    """Return an excerpt of the test stretches with the free runs of the stable models.

    Of all excerpts, sorted by the output's standard deviation, the one at the 75th percentile is
    taken.
    """
    length = min(FIGURE_SAMPLES, min(len(y) for _, y in test) - skip)
    places = [
        (float(np.std(y[at : at + length])), i, at)
        for i, (_, y) in enumerate(test)
        for at in range(skip, len(y) - length + 1, max(length // 2, 1))
    ]
    places.sort()
    _, index, at = places[(3 * len(places)) // 4]
    u, y = test[index]
    names = [n for n in ("arx_free_run", "subspace", "output_error") if fits[n]["stable"]]
    return {
        "stretch": index,
        "time_s": (at + np.arange(length)) * period_s,
        "measured": y[at : at + length],
        "runs": {n: models[n].simulate(u, y[:skip])[at : at + length] for n in names},
    }
