"""Figures of the NARX study: the paper's figure 5, and one-step against free-run errors."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from training.pages.figure import LIMIT, drawing, legend
from training.study.narx.candidates import ALGORITHMS, BAYES, DESCENT
from training.study.narx.verdicts import correlations, errors

ROLES = {"train": "training", "validate": "validation", "test": "test"}
ROLE_COLOURS = {"train": "C0", "validate": "C1", "test": "C2"}
R_TICKS = (0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.998, 0.999, 0.9995, 0.9999)
MARKS = {"train": "o", "validate": "s", "test": "^"}
COLOURS = dict(zip(ALGORITHMS, ("C0", "C1", "C2", "C4"), strict=True))
R_FLOOR = 0.5  # correlations below are drawn at the lower edge
TITLES = {"one_step": "one step ahead", "free_run": "free run (closed loop)"}


def correlation_figure(result: Mapping[str, Any]) -> Figure:
    """Draw R of training, validation and test and the MSE of every model, as the paper does."""
    models = [m for m in result["models"] if m["same_as"] is None]
    figure = Figure(figsize=(9, 7.5), layout="constrained")
    axes: list[Axes] = list(figure.subplots(3, 1, sharex=True))
    for axis, mode, title in zip(axes, ("one_step", "free_run"), TITLES.values(), strict=False):
        _draw_correlations(axis, models, mode)
        axis.set_title(title)
    axes[0].legend(ncols=3, loc="lower left")
    _draw_mse(axes[2], models)
    axes[2].set_xticks(range(len(models)), [_tick(m) for m in models], rotation=90)
    return figure


def _draw_correlations(axis: Axes, models: Sequence[Mapping[str, Any]], mode: str) -> None:
    """Draw R on an axis that is logarithmic in 1 - R, since good models differ only there."""
    smallest = 1.0
    for shift, role in zip((-0.22, 0.0, 0.22), ROLES, strict=True):
        below = [1 - np.nan_to_num(correlations(m, mode, role)) for m in models]
        below = [np.clip(v, 1e-6, 1 - R_FLOOR) for v in below]
        middle = np.array([np.median(v) for v in below])
        bars = np.array([[m - v.min(), v.max() - m] for m, v in zip(middle, below, strict=True)])
        axis.errorbar(
            np.arange(len(models)) + shift,
            middle,
            bars.T,
            fmt=MARKS[role],
            ms=4,
            lw=1,
            color=ROLE_COLOURS[role],
            label=ROLES[role],
        )
        smallest = min(smallest, float(min(v.min() for v in below)))
    axis.set(yscale="log", ylim=(1.1 * (1 - R_FLOOR), 0.7 * smallest), ylabel="R")
    ticks = [t for t in R_TICKS if 1 - t > 0.7 * smallest]
    axis.set_yticks([1 - t for t in ticks], [f"{t:g}" for t in ticks])
    axis.minorticks_off()
    axis.grid(axis="y", alpha=0.3)


def _draw_mse(axis: Axes, models: Sequence[Mapping[str, Any]]) -> None:
    at = np.arange(len(models))
    for mode, shift, colour in (("one_step", -0.2, "#9db8d9"), ("free_run", 0.2, "C0")):
        values = np.array([np.median(errors(m, mode, "test") ** 2) for m in models])
        values[~np.isfinite(values)] = np.nan
        axis.bar(at + shift, values, 0.4, color=colour, label=TITLES[mode])
    axis.set(yscale="log", ylabel="MSE of the test blocks, scaled", title="mean squared error")
    axis.legend(ncols=2)
    axis.grid(axis="y", alpha=0.3)


def _tick(model: Mapping[str, Any]) -> str:
    algorithm = "BR" if model["algorithm"] == BAYES else model["algorithm"]
    rate = f" {model['rate']:g}" if algorithm == DESCENT and model["rate"] is not None else ""
    layers = "-".join(map(str, model["hidden"]))
    return f"{model['number']}  {algorithm} {model['lags']} {layers}{rate}"


def free_run_figure(result: Mapping[str, Any]) -> Figure:
    """Draw the free-run error of every start over its one-step error, and the tuned models."""
    models = [m for m in result["models"] if m["same_as"] is None]
    figure, axis = drawing(4.5)
    for algorithm, words in ALGORITHMS.items():
        own = [m for m in models if m["algorithm"] == algorithm]
        if own:
            one = np.concatenate([errors(m, "one_step", "validate") for m in own])
            free = np.concatenate([errors(m, "free_run", "validate") for m in own])
            axis.plot(one, free, "o", ms=5, alpha=0.7, color=COLOURS[algorithm], label=words)
    for index, tuned in enumerate(result["tuned"]):
        label = "after closed-loop tuning" if index == 0 else None
        axis.plot(*_point(tuned["after"]), "*", ms=9, color="black", label=label)
    every = np.concatenate([errors(m, "one_step", "validate") for m in models])
    ends = [every[np.isfinite(every)].min(), every[np.isfinite(every)].max()]
    axis.plot(ends, ends, ":", color=LIMIT, label="equal")
    axis.set(
        xscale="log",
        yscale="log",
        xlabel="one-step RMSE on validation blocks, scaled",
        ylabel="free-run RMSE on validation blocks, scaled",
    )
    for each in (axis.xaxis, axis.yaxis):
        each.set_major_locator(LogLocator(subs=(1, 2, 5)))
        each.set_major_formatter("{x:g}")
        each.set_minor_formatter(NullFormatter())
    legend(axis, "beside")
    axis.grid(alpha=0.3)
    return figure


def _point(figures: Mapping[str, Any]) -> tuple[float, float]:
    values = [figures[m]["validate"]["enabled"]["mse"] for m in ("one_step", "free_run")]
    one, free = (np.nan if v is None else float(np.sqrt(v)) for v in values)
    return one, free
