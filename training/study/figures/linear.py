"""Figures of the linear baselines, from the stored result."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from monitor.base.types import FloatArray
from training.pages.figure import MEASURED, drawing, legend, panels
from training.pages.numbers import with_unit
from training.study.words import TITLES

Result = Mapping[str, Any]

COLOURS = {"arx_free_run": "C0", "subspace": "C2", "output_error": "C1"}


def _numbers(values: Sequence[float | None]) -> FloatArray:
    return np.array(values, dtype=np.float64)  # NaN where JSON has null


def example(result: Result) -> Figure:
    """Return a part of the test samples with the free runs."""
    shown = result["example"]
    figure, axes = drawing(3.2)
    axes.plot(shown["time_s"], shown["measured"], color=MEASURED, linewidth=1.1, label="measured")
    for name, run in shown["runs"].items():
        axes.plot(shown["time_s"], run, color=COLOURS[name], linewidth=0.9, label=TITLES[name])
    label = with_unit(result["output"], result["unit"])
    axes.set(xlabel=f"s of test stretch {shown['stretch']}", ylabel=label)
    legend(axes)
    return figure


def impulse_figure(result: Result) -> Figure:
    """Return the impulse responses with their 99 % bands."""
    rows, period_s = result["impulse"]["rows"], result["period_s"]
    figure, grid = panels(len(rows), min(3, len(rows)), height=2.1)
    for axes, row in zip(grid, rows, strict=True):
        t_s = np.arange(len(row["response"])) * period_s
        band = _numbers(row["band"])
        axes.fill_between(t_s, -band, band, color="0.85", step="mid")
        axes.plot(t_s, row["response"], marker=".", markersize=3, linewidth=0.8)
        if row["delay"] is not None:
            axes.axvline(row["delay"] * period_s, color="C3", linestyle="--", linewidth=0.8)
        axes.set_title(row["input"])
    figure.supxlabel("s after a pulse of one sample")
    figure.supylabel(f"{result['output']} per unit of input")
    return figure


def criteria(result: Result) -> Figure:
    """Return the three criteria over the number of parameters."""
    titles = {"validation_loss": "sum of squares, validation", "mdl": "MDL", "aic": "AIC"}
    found = result["arx"]
    figure, grid = panels(3, 3, height=2.8)
    for axes, (key, title) in zip(grid, titles.items(), strict=True):
        values = _numbers(found[key])
        axes.plot(found["parameters"], values, linewidth=1.0)
        best = int(np.nanargmin(values))
        axes.plot(found["parameters"][best], values[best], "o", color="C3", markersize=4)
        axes.set_yscale("linear" if key == "aic" else "log")
        axes.set(title=title, xlabel="parameters")
    return figure


def singular_values(result: Result) -> Figure:
    """Return the singular values and the free-run error over the number of states."""
    found = result["subspace"]
    figure, (left, right) = panels(2, 2, height=2.8)
    values, errors = found["singular_values"][:20], _numbers(found["validation_rmse"])
    orders = np.arange(1, len(values) + 1)
    left.bar(orders, values, color=["C0" if o <= found["order"] else "0.8" for o in orders])
    left.set(yscale="log", xlabel="state", ylabel="singular value")
    left.set_xticks(orders[1::2])
    right.set_xticks(range(1, len(errors) + 1))
    right.plot(np.arange(1, len(errors) + 1), errors, marker=".")
    right.plot(found["order"], errors[found["order"] - 1], "o", color="C3", markersize=5)
    right.set(xlabel="states", ylabel="RMSE, validation, free run")
    if np.isfinite(errors).any():
        low, high = float(np.nanmin(errors)), float(np.nanmax(errors))
        right.set_ylim(0.9 * low, min(2.5 * low, 1.05 * high + 1e-12))
    return figure


def correlations(result: Result) -> Figure:
    """Return the residual correlations with their 99 % bands."""
    tests = result["residuals"]["arx_aic"]
    white, inputs = tests["whiteness"], tests["independence"]
    figure, grid = panels(len(inputs) + 1, min(3, len(inputs) + 1), height=2.1)
    own = {"lags": range(1, white["lags"] + 1), "correlation": white["autocorrelation"][1:]}
    first = {"band": white["band"], "input": "", **own}
    for axes, test in zip(grid, [first, *inputs], strict=True):
        axes.axhspan(-test["band"], test["band"], color="0.85")
        axes.vlines(test["lags"], 0.0, test["correlation"], linewidth=1.0)
        axes.set_title(f"with {test['input']}" if test["input"] else "autocorrelation")
        axes.axhline(0.0, color="0.4", linewidth=0.6)
    figure.supxlabel("lag in samples; one-step residuals of the ARX chosen by AIC")
    return figure
