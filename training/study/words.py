"""Cells and sentences of the study's page."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from monitor.base.counts import plain
from training.pages.numbers import p_value, unbroken
from training.study.narx.candidates import PAPER
from training.study.narx.verdicts import ROLES, correlations, errors

Result = Mapping[str, Any]

TITLES: Final = {
    "arx_sum_of_squares": "ARX, sum of squares",
    "arx_mdl": "ARX, MDL",
    "arx_aic": "ARX, AIC",
    "arx_free_run": "ARX, free run",
    "state_space": "state space",
    "output_error": "output error",
}


def tests(found: Result) -> list[str]:
    """Return the cells of one model: whiteness, p, lags, independence, correlation, feedback."""
    white, each = found["whiteness"], found["independence"]
    worst = max(each, key=lambda test: test["largest"])
    rejected, feedback = ([t["input"] for t in each if t[k]] for k in ("rejected", "feedback"))
    return [
        "rejected" if white["rejected"] else "not rejected",
        p_value(white["p_value"]),
        f"{white['outside']} of {white['lags']}",
        f"rejected for {_named(rejected, len(each))}" if rejected else "not rejected",
        f"{worst['largest']:.2f}, {worst['input']}",
        _named(feedback, len(each)) if feedback else "none",
    ]


def _named(names: Sequence[str], total: int) -> str:
    return ", ".join(names) if len(names) < 3 else f"{len(names)} of {total}"


def narx_row(model: Result) -> tuple[str, ...]:
    """Return the cells of one of the 29 models."""
    name = unbroken(f"{model['number']}  {model['name']}")
    name += unbroken(" (paper)") if model["origin"] == PAPER else ""
    if model["same_as"] is not None:
        same = unbroken(f"same training as {model['same_as']}")
        return (name, str(model["n_weights"]), same, *[""] * 5)
    free = errors(model, "free_run", "test")
    finite = len(free) > 1 and bool(np.isfinite(free).all())
    cells = [name, str(model["n_weights"])]
    for mode in ("one_step", "free_run"):
        medians = [np.median(correlations(model, mode, role)) for role in ROLES]
        cells.append(unbroken(" / ".join(f"{m:.3f}" for m in medians)))
        cells.append(plain(np.median(errors(model, mode, "test") ** 2), 2))
    return (
        *cells,
        ", ".join(model["verdict"]) or "–",
        f"{100 * free.std(ddof=1) / free.mean():.0f} %" if finite else "",
    )
