"""Figures of the linear baselines, from the stored result."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from training.pages.figure import MEASURED, drawing, legend, panels
from training.pages.numbers import with_unit

Result = dict[str, Any]

TITLES = {
    "arx_sum_of_squares": "ARX, sum of squares",
    "arx_mdl": "ARX, MDL",
    "arx_aic": "ARX, AIC",
    "arx_free_run": "ARX, free run",
    "subspace": "state space",
    "output_error": "output error",
}
COLOURS = {"arx_free_run": "C0", "subspace": "C2", "output_error": "C1"}


def fit_chart(result: Result, ranges: Sequence[str]) -> Figure:
    """Return bars of the free-run fits, over all samples and per range."""
    models = result["models"]
    groups = ["all samples", *ranges]
    figure, axes = drawing(3.2)
    width = 0.8 / len(models)
    for i, (name, m) in enumerate(models.items()):
        values = [m["fit_percent"], *m["regime_fit_percent"]]
        heights = [max(v, -20.0) if v is not None else 0.0 for v in values]
        shift = (i - (len(models) - 1) / 2) * width
        axes.bar(np.arange(len(groups)) + shift, heights, 0.9 * width, label=TITLES[name])
    axes.axhline(0.0, color="0.3", linewidth=0.8)
    axes.set_xticks(range(len(groups)), groups)
    axes.set_ylabel("fit, %")
    if ranges:
        axes.set_xlabel(result["regime"]["name"])
    legend(axes, columns=6)
    return figure


def example(result: Result) -> Figure:
    """Return a part of the test samples with the free runs."""
    shown = result["example"]
    figure, axes = drawing(3.2)
    axes.plot(shown["time_s"], shown["measured"], color=MEASURED, linewidth=1.1, label="measured")
    for name, run in shown["runs"].items():
        axes.plot(shown["time_s"], run, color=COLOURS[name], linewidth=0.9, label=TITLES[name])
    axes.set(xlabel=f"s of test stretch {shown['stretch']}", ylabel=output_label(result))
    legend(axes)
    return figure


def impulse_figure(result: Result) -> Figure:
    """Return the impulse responses with their 99 % bands."""
    rows = result["impulse"]["rows"]
    figure, grid = panels(len(rows), min(3, len(rows)), height=2.1)
    for axes, row in zip(grid, rows, strict=True):
        t_s = np.arange(len(row["response"])) * result["period_s"]
        band = np.array(row["band"], dtype=float)
        axes.fill_between(t_s, -band, band, color="0.85", step="mid")
        axes.plot(t_s, row["response"], marker=".", markersize=3, linewidth=0.8)
        if row["delay"] is not None:
            axes.axvline(
                row["delay"] * result["period_s"], color="C3", linestyle="--", linewidth=0.8
            )
        axes.set_title(row["input"])
    figure.supxlabel("s after a pulse of one sample")
    figure.supylabel(f"{result['output']} per unit of input")
    return figure


def criteria(result: Result) -> Figure:
    """Return the three criteria over the number of parameters."""
    found = result["arx"]
    figure, grid = panels(3, 3, height=2.8)
    titles = ("sum of squares, validation", "MDL", "AIC")
    for axes, key, title in zip(grid, ("validation_loss", "mdl", "aic"), titles, strict=True):
        values = np.array(found[key], dtype=float)
        axes.plot(found["parameters"], values, linewidth=1.0)
        best = int(np.nanargmin(values))
        axes.plot(found["parameters"][best], values[best], "o", color="C3", markersize=4)
        if key != "aic":
            axes.set_yscale("log")
        axes.set(title=title, xlabel="parameters")
    return figure


def singular_values(result: Result) -> Figure:
    """Return the singular values and the free-run error over the number of states."""
    found = result["subspace"]
    figure, (left, right) = panels(2, 2, height=2.8)
    values = found["singular_values"][:20]
    orders = np.arange(1, len(values) + 1)
    left.bar(orders, values, color=["C0" if o <= found["order"] else "0.8" for o in orders])
    left.set(yscale="log", xlabel="state", ylabel="singular value")
    left.set_xticks(orders[1::2])
    right.set_xticks(range(1, len(found["validation_rmse"]) + 1))
    errors = np.array([np.nan if e is None else e for e in found["validation_rmse"]])
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
    first, *others = grid
    first.axhspan(-white["band"], white["band"], color="0.85")
    first.vlines(range(1, white["lags"] + 1), 0.0, white["autocorrelation"][1:], linewidth=1.2)
    first.set_title("autocorrelation")
    for axes, test in zip(others, inputs, strict=True):
        axes.axhspan(-test["band"], test["band"], color="0.85")
        axes.vlines(test["lags"], 0.0, test["correlation"], linewidth=1.0)
        axes.set_title(f"with {test['input']}")
    for axes in grid:
        axes.axhline(0.0, color="0.4", linewidth=0.6)
    figure.supxlabel("lag in samples; one-step residuals of the ARX chosen by AIC")
    return figure


def output_label(result: Result) -> str:
    """Return the axis label of the output."""
    return with_unit(result["output"], result["unit"])
