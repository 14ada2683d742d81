"""Figures of the chosen model: against the sensor, its residuals, steady against mixed."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from monitor.base.types import FloatArray
from training.pages.figure import LIMIT, MEASURED, drawing, legend, panels
from training.pages.numbers import unit_of, with_unit, words

Result = Mapping[str, Any]

PAPER_RULE: Any = {"color": "0.3", "linewidth": 0.8, "linestyle": ":"}


def sensor_figure(views: Sequence[Result], sensor: Result) -> Figure:
    """Draw an excerpt and a scatter of each view, as figure 6 of the paper."""
    figure, grid = panels(2 * len(views), 2, height=2.3, width_ratios=[3.4, 1])
    for left, right, view in zip(grid[::2], grid[1::2], views, strict=True):
        shown = view["excerpt"]
        series = {"sensor": shown["measured"], "model, free run": shown["predicted"]}
        _excerpt(left, series, [*series], view["judged"], sensor)
        left.set_title(f"{view['title']} ({view['source']})", loc="left")
        left.yaxis.label.set_fontsize(9 if len(label(sensor)) < 20 else 7)
        _scatter(right, view)
    legend(grid[0])
    grid[-2].set_xlabel("s of the excerpt")
    grid[-1].set_xlabel("measured")
    return figure


def label(result: Result) -> str:
    """Return the output's name and unit for an axis."""
    return with_unit(result["output"], result["unit"])


def _array(values: Sequence[float | None]) -> FloatArray:
    return np.array(values, dtype=np.float64)  # NaN where JSON has null


def _excerpt(
    axes: Axes,
    series: Mapping[str, Sequence[float | None]],
    framing: Sequence[str],
    judged_rows: Sequence[int],
    result: Result,
) -> None:
    """Draw the series over time, samples that are not judged on grey.

    framing : the series whose judged samples set the axis
    """
    judged = np.array(judged_rows, dtype=bool)
    t_s = np.arange(len(judged)) * result["period_s"]
    colours = (MEASURED, *(("C1",) if len(series) == 2 else ("C3", "C2")))
    for (name, values), colour in zip(series.items(), colours, strict=True):
        axes.plot(t_s, _array(values), color=colour, linewidth=0.9, label=name)
    if not judged.all():
        whole: Any = {"transform": axes.get_xaxis_transform(), "color": "0.92", "linewidth": 0}
        axes.fill_between(t_s, 0, 1, where=~judged, **whole)
    inside = np.concatenate([_array(series[name])[judged | ~judged.any()] for name in framing])
    inside = inside[np.isfinite(inside)]
    if len(inside):
        low, high = np.quantile(inside, [0.01, 0.99])
        margin = 0.35 * max(high - low, 1e-9)
        axes.set_ylim(low - margin, high + margin)
    axes.set_ylabel(label(result))
    axes.margins(x=0)


def _scatter(axes: Axes, view: Result) -> None:
    x, y = (_array(view["scatter"][k]) for k in ("measured", "predicted"))
    axes.plot(x, y, ".", markersize=2, alpha=0.4, color="C0")
    if len(x):
        low, high = np.quantile(np.concatenate([x, y]), [0.005, 0.995])
        margin = 0.1 * max(high - low, 1e-9)
        ends = (low - margin, high + margin)
        axes.plot(ends, ends, color=LIMIT, linewidth=0.8)
        axes.set(xlim=ends, ylim=ends)
    r = view["enabled"].get("correlation")
    axes.set_title("" if r is None else f"R = {r:.3f}")
    axes.set_ylabel("predicted")


def residual_figure(sensor: Result) -> Figure:
    """Draw the residual's distribution under each fault over the healthy one, as figure 7."""
    faults, edges = sensor["faults"], np.array(sensor["edges"])
    figure, grid = panels(
        len(faults), min(3, len(faults)), height=2.4, extra=0.2, sharex=True, sharey=True
    )
    for axes, fault in zip(grid, faults, strict=True):
        axes.stairs(sensor["healthy"]["share"], edges, fill=True, color="0.8", label="healthy")
        axes.stairs(fault["share"], edges, color="C3", linewidth=1.1, label="faulty")
        axes.set_yscale("log")
        axes.set_title(words(fault["name"]))
        _limit_mean(axes, sensor)
    grid[0].legend()
    figure.supxlabel(f"measured − predicted {label(sensor)}")
    figure.supylabel("share of samples")
    return figure


def _limit_mean(axes: Axes, sensor: Result) -> None:
    if (limit := sensor["limits"].get("j_mu")) is not None:
        for sign in (-1, 1):
            axes.axvline(sign * limit, **PAPER_RULE)


def window_figure(sensor: Result) -> Figure:
    """Draw mean and standard deviation of windows with the limits of the paper's rule."""
    figure, axes = drawing(3.6)
    every, j = (*sensor["faults"], sensor["healthy"] | {"name": "healthy"}), sensor["limits"]
    for index, each in enumerate(every):
        look: Any = {"marker": ".", "alpha": 0.6, "color": f"C{index}"}
        if each is every[-1]:
            look = {"marker": "x", "color": "black"}
        x, y = each["window_mean"], each["window_std"]
        axes.plot(x, y, linestyle="", markersize=4, label=words(each["name"]), **look)
    _limit_mean(axes, sensor)
    if "j_sigma" in j:
        axes.axhline(j["j_sigma"], **PAPER_RULE)
    means, stds = (np.concatenate([f[k] for f in every]) for k in ("window_mean", "window_std"))
    if len(stds):
        low, high = np.quantile(means, [0.01, 0.99])
        margin = 0.2 * max(high - low, 2.0 * j.get("j_mu", 0.0), 1e-9)
        axes.set_xlim(low - margin, high + margin)
        axes.set_ylim(0.0, 1.2 * max(float(np.quantile(stds, 0.97)), j.get("j_sigma", 0.0)))
    unit = unit_of(sensor["unit"])
    axes.set_xlabel(with_unit("mean of a window's residuals", unit))
    axes.set_ylabel(with_unit("standard deviation", unit))
    legend(axes, "beside")
    return figure


def steady_figure(result: Result) -> Figure:
    """Draw the same transient excerpt predicted after steady and after mixed training."""
    shown = result["example"]
    figure, axes = drawing(3.2)
    series = {
        "sensor": shown["measured"],
        "steady training": shown["steady"],
        "mixed training": shown["mixed"],
    }
    _excerpt(axes, series, ("sensor",), shown["judged"], result)
    axes.set_xlabel("s of the excerpt")
    legend(axes)
    return figure
