"""Figures of the NARX study: the paper's figure 5, and one-step against free-run errors."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from training.pages.figure import LIMIT, drawing, legend
from training.study.narx.candidates import ALGORITHMS, BAYES, DESCENT
from training.study.narx.verdicts import ROLES, correlations, errors

R_TICKS = (0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.998, 0.999, 0.9995, 0.9999)
LOOKS = {"train": (-0.22, "o", "C0"), "validate": (0.0, "s", "C1"), "test": (0.22, "^", "C2")}
COLOURS = dict(zip(ALGORITHMS, ("C0", "C1", "C2", "C4"), strict=True))
R_FLOOR = 0.5  # correlations below are drawn at the lower edge
MODES = {
    "one_step": ("one step ahead", -0.2, "#9db8d9"),
    "free_run": ("free run (closed loop)", 0.2, "C0"),
}

Models = Sequence[Mapping[str, Any]]


def correlation_figure(result: Mapping[str, Any]) -> Figure:
    """Draw R of training, validation and test and the MSE of every model, as the paper does."""
    models = [m for m in result["models"] if m["same_as"] is None]
    figure = Figure(figsize=(9, 7.5), layout="constrained")
    axes: list[Axes] = list(figure.subplots(3, 1, sharex=True))
    for axis, (mode, (title, shift, colour)) in zip(axes, MODES.items(), strict=False):
        _draw_correlations(axis, models, mode)
        axis.set_title(title)
        values = np.array([np.median(errors(m, mode, "test") ** 2) for m in models])
        values[~np.isfinite(values)] = np.nan
        axes[2].bar(np.arange(len(models)) + shift, values, 0.4, color=colour, label=title)
    axes[0].legend(ncols=3, loc="lower left")
    axes[2].set(yscale="log", ylabel="MSE of the test blocks, scaled", title="mean squared error")
    axes[2].legend(ncols=2)
    axes[2].grid(axis="y", alpha=0.3)
    axes[2].set_xticks(range(len(models)), [_tick(m) for m in models], rotation=90)
    return figure


def _draw_correlations(axis: Axes, models: Models, mode: str) -> None:
    """Draw R on an axis that is logarithmic in 1 - R, since good models differ only there."""
    smallest = 1.0
    for role, (shift, mark, colour) in LOOKS.items():
        below = [1 - np.nan_to_num(correlations(m, mode, role)) for m in models]
        below = [np.clip(v, 1e-6, 1 - R_FLOOR) for v in below]
        middle, low, high = (np.array([f(v) for v in below]) for f in (np.median, np.min, np.max))
        look: dict[str, Any] = {"fmt": mark, "ms": 4, "lw": 1, "color": colour}
        at = np.arange(len(models)) + shift
        axis.errorbar(at, middle, (middle - low, high - middle), label=ROLES[role], **look)
        smallest = min(smallest, float(low.min()))
    axis.set(yscale="log", ylim=(1.1 * (1 - R_FLOOR), 0.7 * smallest), ylabel="R")
    ticks = [t for t in R_TICKS if 1 - t > 0.7 * smallest]
    axis.set_yticks([1 - t for t in ticks], [f"{t:g}" for t in ticks])
    axis.minorticks_off()
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
        if own := [m for m in models if m["algorithm"] == algorithm]:
            one, free = (
                np.concatenate([errors(m, mode, "validate") for m in own]) for mode in MODES
            )
            axis.plot(one, free, "o", ms=5, alpha=0.7, color=COLOURS[algorithm], label=words)
    for index, tuned in enumerate(result["tuned"]):
        label = "after closed-loop tuning" if index == 0 else None
        point = [tuned["after"][mode]["validate"]["enabled"]["mse"] for mode in MODES]
        x, y = (np.nan if v is None else float(np.sqrt(v)) for v in point)
        axis.plot(x, y, "*", ms=9, color="black", label=label)
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
