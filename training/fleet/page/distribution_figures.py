"""Figures of a fleet: how the statistics are distributed, and which vehicles stand out."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from training.fleet.page.outliers import Standing
from training.limits.rates import Figures
from training.pages.figure import LIMIT, panels

BINS: Final = 80
NAMED: Final = 12  # vehicles that stand out whose names are written


def distribution_figure(
    recordings: pl.DataFrame, windows: Path, limits: Sequence[Figures]
) -> Figure:
    """Draw histograms of windows and drives; lines are present (dashed) and proposed limits."""
    figure, grid = panels(6, 3, height=2.8)
    by_name = {each["name"]: each for each in limits}
    contents: tuple[tuple[str, str, bool, str | None], ...] = (
        ("mean", "mean residual of a window", True, "j_mu"),
        ("std", "residual's spread in a window", True, "j_sigma"),
        ("evidence", "evidence for a faulty sensor in a drive", False, None),
        ("offset", "offset at a drive's end", False, "offset"),
        ("gain", "gain at a drive's end", False, None),
        ("enabled_share", "share of a drive that may be judged", False, None),
    )
    drives = recordings.with_columns(
        (pl.col("enabled_s") / pl.col("duration_s")).alias("enabled_share")
    )
    for axes, (column, title, of_windows, limit) in zip(grid, contents, strict=True):
        if of_windows:
            values = pl.scan_parquet(windows).select(column).collect()[column]
        else:
            values = drives[column]
        _histogram(axes, values.drop_nulls().to_numpy(), title, by_name.get(limit or ""))
    figure.supylabel("number of windows or drives (logarithmic)")
    return figure


def standing_figure(found: Sequence[Standing], chosen: Mapping[str, int]) -> Figure:
    """Draw every vehicle's distance from the fleet's median.

    chosen : vehicles that stand out by any statistic, and the number each has in the table
    """
    figure, grid = panels(len(found), 1, height=1.5, extra=0.9)
    for axes, each in zip(grid, found, strict=True):
        out = set(each.out)
        order = np.argsort(each.distance, kind="stable")
        far = 1.25 * max(each.limit, *np.abs(each.distance[np.isfinite(each.distance)]), 1.0)
        x = np.clip(each.distance[order], -far, far)
        y = (np.arange(len(order)) + 0.5) / len(order)
        is_out = np.array([i in out for i in order.tolist()])
        axes.plot(x[~is_out], y[~is_out], ".", color="C0", markersize=4)
        axes.plot(x[is_out], y[is_out], "o", color="C3", markersize=5)
        for i, x_i, y_i in zip(order.tolist(), x.tolist(), y.tolist(), strict=True):
            number = chosen.get(each.vehicles[i])
            if i in out and number is not None and number <= NAMED:
                axes.annotate(
                    str(number),
                    (x_i, y_i),
                    xytext=(5, -3 if y_i > 0.5 else 3),
                    textcoords="offset points",
                    size=8,
                )
        for side in (-each.limit, each.limit):
            axes.axvline(side, color=LIMIT, linewidth=0.8, linestyle="--")
        axes.set(xlim=(-far, far), ylim=(-0.08, 1.08), yticks=(0, 0.5, 1))
        axes.set_title(each.statistic.title, loc="left")
    grid[-1].set_xlabel("robust standard deviations from the fleet's median")
    figure.supylabel("share of the vehicles below")
    return figure


def _histogram(axes: Axes, values: np.ndarray, title: str, limit: Figures | None) -> None:
    axes.set_title(title)
    if not len(values):
        axes.text(0.5, 0.5, "none", ha="center", va="center", transform=axes.transAxes)
        return
    low, high = (
        np.quantile(values, (0.001, 0.999)) if len(values) > 1000 else (values.min(), values.max())
    )
    span = max(float(high - low), 1e-6)
    inside = np.clip(values, low - 0.02 * span, high + 0.02 * span)  # the ends gather the rest
    axes.hist(inside, bins=BINS, color="C0")
    axes.set_yscale("log")
    axes.set_ylim(bottom=0.7)
    axes.xaxis.set_major_locator(MaxNLocator(5, steps=(1, 2, 2.5, 5, 10)))
    if limit is None:
        return
    sides = (-1.0, 1.0) if values.min() < 0.0 else (1.0,)
    for value, style in ((limit["now"], "--"), (limit["proposed"], "-")):
        for side in sides if value is not None else ():
            axes.axvline(side * value, color="C3", linewidth=1.0, linestyle=style)
