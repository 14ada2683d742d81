"""Figures of the chosen model: against the sensor, its residuals, steady against mixed."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from monitor.base.types import FloatArray
from training.pages.figure import LIMIT, MEASURED, drawing, legend, panels
from training.pages.numbers import unit_of, with_unit, words

PREDICTED, OTHER = "C1", "C0"


def sensor_figure(views: Sequence[Mapping[str, Any]], sensor: Mapping[str, Any]) -> Figure:
    """Draw an excerpt and a scatter of each view, as figure 6 of the paper."""
    figure, grid = panels(2 * len(views), 2, height=2.3, width_ratios=[3.4, 1])
    for left, right, view in zip(grid[::2], grid[1::2], views, strict=True):
        _excerpt(left, view, sensor)
        _scatter(right, view)
    legend(grid[0])
    grid[-2].set_xlabel("s of the excerpt")
    grid[-1].set_xlabel("measured")
    return figure


def label(sensor: Mapping[str, Any]) -> str:
    """Return the output's name and unit for an axis."""
    return with_unit(sensor["output"], sensor["unit"])


def array(values: Sequence[float | None]) -> FloatArray:
    """Return numbers with NaN where JSON has null."""
    return np.array([np.nan if v is None else v for v in values], dtype=np.float64)


def _excerpt(axes: Axes, view: Mapping[str, Any], sensor: Mapping[str, Any]) -> None:
    measured, predicted = (array(view["excerpt"][k]) for k in ("measured", "predicted"))
    t_s = np.arange(len(measured)) * sensor["period_s"]
    axes.plot(t_s, measured, color=MEASURED, linewidth=0.9, label="sensor")
    axes.plot(t_s, predicted, color=PREDICTED, linewidth=0.9, label="model, free run")
    _frame(axes, t_s, np.array(view["judged"], dtype=bool), [measured, predicted])
    axes.set_title(f"{view['title']} ({view['source']})", loc="left")
    axes.set_ylabel(label(sensor), size=9 if len(label(sensor)) < 20 else 7)
    axes.margins(x=0)


def _frame(axes: Axes, t_s: FloatArray, judged: np.ndarray, series: Sequence[FloatArray]) -> None:
    """Mark samples that are not judged in grey and let the judged samples set the axis."""
    if len(judged) and not judged.all():
        axes.fill_between(
            t_s,
            0,
            1,
            where=~judged,
            transform=axes.get_xaxis_transform(),
            color="0.92",
            linewidth=0,
        )
    inside = np.concatenate([each[judged | ~judged.any()] for each in series])
    inside = inside[np.isfinite(inside)]
    if len(inside):
        low, high = np.quantile(inside, [0.01, 0.99])
        margin = 0.35 * max(high - low, 1e-9)
        axes.set_ylim(low - margin, high + margin)


def _scatter(axes: Axes, view: Mapping[str, Any]) -> None:
    x, y = (array(view["scatter"][k]) for k in ("measured", "predicted"))
    axes.plot(x, y, ".", markersize=2, alpha=0.4, color=OTHER)
    if len(x):
        low, high = np.quantile(np.concatenate([x, y]), [0.005, 0.995])
        margin = 0.1 * max(high - low, 1e-9)
        ends = (low - margin, high + margin)
        axes.plot(ends, ends, color=LIMIT, linewidth=0.8)
        axes.set(xlim=ends, ylim=ends)
    r = view["enabled"].get("correlation")
    axes.set_title("" if r is None else f"R = {r:.3f}")
    axes.set_ylabel("predicted")


def residual_figure(sensor: Mapping[str, Any]) -> Figure:
    """Draw the residual's distribution under each fault over the healthy one, as figure 7."""
    faults = sensor["faults"]
    edges = np.array(sensor["edges"])
    figure, grid = panels(
        len(faults), min(3, len(faults)), height=2.4, extra=0.2, sharex=True, sharey=True
    )
    for axes, fault in zip(grid, faults, strict=True):
        axes.stairs(sensor["healthy"]["share"], edges, fill=True, color="0.8", label="healthy")
        axes.stairs(fault["share"], edges, color="C3", linewidth=1.1, label="faulty")
        axes.set_yscale("log")
        axes.set_title(words(fault["name"]))
        limit = sensor["limits"].get("j_mu")
        for sign in (-1, 1):
            if limit is not None:
                axes.axvline(sign * limit, color="0.3", linewidth=0.7, linestyle=":")
    grid[0].legend()
    figure.supxlabel(f"measured − predicted {label(sensor)}")
    figure.supylabel("share of samples")
    return figure


def window_figure(sensor: Mapping[str, Any]) -> Figure:
    """Draw mean and standard deviation of windows with the limits of the paper's rule."""
    figure, axes = drawing(3.6)
    healthy = sensor["healthy"]
    for index, fault in enumerate(sensor["faults"]):
        axes.plot(
            fault["window_mean"],
            fault["window_std"],
            ".",
            markersize=4,
            alpha=0.6,
            color=f"C{index}",
            label=words(fault["name"]),
        )
    axes.plot(
        healthy["window_mean"],
        healthy["window_std"],
        "x",
        markersize=4,
        color="black",
        label="healthy",
    )
    j = sensor["limits"]
    if "j_mu" in j:
        for sign in (-1, 1):
            axes.axvline(sign * j["j_mu"], color="0.3", linewidth=0.8, linestyle=":")
        axes.axhline(j["j_sigma"], color="0.3", linewidth=0.8, linestyle=":")
    every = (healthy, *sensor["faults"])
    means, stds = (np.concatenate([f[k] for f in every]) for k in ("window_mean", "window_std"))
    if len(stds):
        low, high = np.quantile(means, [0.01, 0.99])
        margin = 0.2 * max(high - low, 2.0 * j.get("j_mu", 0.0), 1e-9)
        axes.set_xlim(low - margin, high + margin)
        axes.set_ylim(0.0, 1.2 * max(float(np.quantile(stds, 0.97)), j.get("j_sigma", 0.0)))
    axes.set_xlabel(with_unit("mean of a window's residuals", unit_of(sensor["unit"])))
    axes.set_ylabel(with_unit("standard deviation", unit_of(sensor["unit"])))
    legend(axes, "beside")
    return figure


def steady_figure(result: Mapping[str, Any]) -> Figure:
    """Draw the same transient excerpt predicted after steady and after mixed training."""
    example = result["example"]
    figure, axes = drawing(3.2)
    measured = array(example["measured"])
    t_s = np.arange(len(measured)) * result["period_s"]
    axes.plot(t_s, measured, color=MEASURED, linewidth=1.0, label="sensor")
    axes.plot(t_s, array(example["steady"]), color="C3", linewidth=0.9, label="steady training")
    axes.plot(t_s, array(example["mixed"]), color="C2", linewidth=0.9, label="mixed training")
    _frame(axes, t_s, np.array(example["judged"], dtype=bool), [measured])
    axes.set(xlabel="s of the excerpt", ylabel=label(result))
    legend(axes)
    axes.margins(x=0)
    return figure
