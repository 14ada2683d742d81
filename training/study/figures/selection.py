"""Figures of the input selection: principal components, and faults that reach the prediction."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from training.pages.figure import LIMIT, drawing, legend, panels

Result = Mapping[str, Any]


def scree_figure(result: Result) -> Figure:
    """Return variances of the components, their cumulated share, and the loadings."""
    figure, (left, right) = panels(2, 2, height=4.0, width_ratios=(2, 3))
    number = np.arange(1, len(result["variances"]) + 1)
    left.bar(number, result["variances"], color="C0", alpha=0.5)
    left.axvline(result["kept"] + 0.5, color=LIMIT, ls="--", lw=0.8)
    left.set_xticks(number)
    left.set(xlabel="component; kept ones left of the dashed line", ylabel="variance (bars)")
    other = left.twinx()
    other.spines["right"].set_visible(True)
    other.plot(number, 100 * np.array(result["explained"]), "o-", color="C0", ms=3)
    other.set(ylim=(0, 103), ylabel="explained together, % (line)")
    n = min(result["kept"] + 1, len(number))
    values = np.array(result["loadings"])[:, :n]
    image = right.imshow(values, cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
    right.set_yticks(range(len(result["names"])), result["names"])
    right.set_xticks(range(n), [str(i + 1) for i in range(n)])
    for (i, j), value in np.ndenumerate(values):
        ink = "white" if abs(value) > 0.6 else "black"
        right.text(j, i, f"{value:.2f}", ha="center", va="center", color=ink)
    right.set_xlabel("component")
    figure.colorbar(image, ax=right, label="loading")
    return figure


def biplot_figure(result: Result) -> Figure:
    """Return scores and loadings of the first two components in one plane."""
    figure, axes = drawing(6.0, width=7.0)
    scale = [np.percentile(np.abs(each), 99) or 1.0 for each in result["scores"]]
    one, two = (np.array(v) / s for v, s in zip(result["scores"], scale, strict=True))
    axes.plot(one, two, ".", color="0.75", ms=3)
    loadings = np.array(result["loadings"])[:, :2]
    largest, free = float(np.abs(loadings).max()), {"left": -np.inf, "right": -np.inf}
    for i in np.argsort(loadings[:, 1]):  # names stand beyond the arrows, one above the other
        x, y = loadings[i]
        side = "left" if x > 0 else "right"
        at = max(1.1 * y, free[side])
        free[side] = at + 0.07 * largest
        axes.annotate("", (x, y), (0, 0), arrowprops={"arrowstyle": "->", "color": "C0"})
        axes.plot([x, 1.1 * x], [y, at], color="C0", lw=0.4)
        axes.text(1.1 * x, at, f" {result['names'][i]} ", size=8, ha=side, va="center")
    reach = 1.45 * max(1e-3, largest)
    share = 100 * np.array(result["variances"]) / np.sum(result["variances"])
    label = "loading on component {}, {:.0f} % of the variance"
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    axes.set(xlabel=label.format(1, share[0]), ylabel=label.format(2, share[1]))
    return figure


def control_figure(result: Result) -> Figure:
    """Return Q residuals and Hotelling's T² over time with their limits."""
    figure, (upper, lower) = panels(2, 1, height=2.4, sharex=True)
    for axes, key, label in ((upper, "q", "Q residual"), (lower, "t_squared", "Hotelling's T²")):
        series, limit = result[key], result[f"{key}_limit"]
        axes.semilogy(series["t_s"], series["largest"], lw=0.7, color="C0")
        axes.axhline(limit, color="C3", lw=0.9, ls="--", label=f"99 % limit {limit:.3g}")
        axes.set_ylabel(label)
        legend(axes)
    lower.set_xlabel("time, s, drives end to end; the largest value of each stretch is drawn")
    return figure


def reach_figure(reach: Sequence[Result]) -> Figure:
    """Return the share of each fault that reaches the prediction, by set of inputs."""
    figure, axes = drawing(3.0, width=8.0)
    faults, sets = (list(dict.fromkeys(r[key] for r in reach)) for key in ("fault", "set"))
    for number, name in enumerate(sets):
        own = [100 * r["share"] for r in reach if r["set"] == name]
        at = [i + (number - 0.5 * (len(sets) - 1)) * 0.25 for i in range(len(faults))]
        axes.bar(at, own, 0.22, label=name)
    axes.set_xticks(range(len(faults)), faults)
    axes.set_ylabel("RMS reaching the\nprediction, %")
    figure.legend(loc="outside upper right", ncols=len(sets))
    return figure
