"""Figures of a fleet: how the statistics are distributed, and which vehicles stand out."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import polars as pl

from monitor.base.types import FloatArray
from monitor.judge.limits import Limits
from training.fleet.page.outliers import Standing
from training.pages.drawing import Drawing, Plot, axis, histogram, layer, plot

BINS: Final = 80
NAMED: Final = 12  # vehicles that stand out whose names are written
AWAY: Final = "robust standard deviations from the fleet's median"


def distribution_figure(recordings: pl.DataFrame, windows: Path, limits: Limits) -> Drawing:
    """Draw histograms of windows and drives; dashed lines are the model's limits."""
    contents = (
        ("mean", "mean residual of a window", True, (-limits.j_mu, limits.j_mu)),
        ("std", "residual's spread in a window", True, (limits.j_sigma,)),
        ("evidence", "evidence for a faulty sensor in a drive", False, ()),
        ("offset", "offset at a drive's end", False, (limits.offset_low, limits.offset_high)),
        ("gain", "gain at a drive's end", False, ()),
        ("enabled_share", "share of a drive that may be judged", False, ()),
    )
    drives = recordings.with_columns(
        (pl.col("enabled_s") / pl.col("duration_s")).alias("enabled_share")
    )
    plots = []
    for column, title, of_windows, at in contents:
        table = pl.read_parquet(windows, columns=[column], glob=False) if of_windows else drives
        plots.append(_histogram(table[column].drop_nulls().to_numpy(), title, at))
    return Drawing(plots, columns=(1, 1, 1))


def standing_figure(found: Sequence[Standing], chosen: Mapping[str, int]) -> Drawing:
    """Draw every vehicle's distance from the fleet's median.

    chosen : vehicles that stand out by any statistic, and the number each has in the table
    """
    plots = []
    for each in found:
        order = np.argsort(each.distance, kind="stable")
        far = 1.25 * max(each.limit, *np.abs(each.distance[np.isfinite(each.distance)]), 1.0)
        x = np.clip(each.distance[order], -far, far)
        y = (np.arange(len(order)) + 0.5) / len(order)
        out = np.isin(order, each.out)
        numbers = [chosen.get(each.vehicles[i], NAMED + 1) for i in order[out].tolist()]
        names = [str(number) if number <= NAMED else "" for number in numbers]
        plots.append(
            plot(
                each.statistic.title,
                layer("rule", x=[-each.limit, each.limit], color="quiet", dash=[5, 4]),
                layer("points", x=x[~out], y=y[~out], size=2.5, color="measured"),
                layer("points", x=x[out], y=y[out], size=4, color="failed", text=names),
                x=axis(AWAY if each is found[-1] else "", low=-far, high=far),
                y=axis(low=-0.08, high=1.08),
                height=110,
            )
        )
    return Drawing(plots)


def _histogram(values: FloatArray, title: str, limits: Sequence[float]) -> Plot:
    if not len(values):
        return plot(f"{title}: none", height=170)
    low, high = (
        np.quantile(values, (0.001, 0.999)) if len(values) > 1000 else (values.min(), values.max())
    )
    span = max(float(high - low), 1e-6)
    inside = np.clip(values, low - 0.02 * span, high + 0.02 * span)  # the ends gather the rest
    lines = [layer("rule", x=[x], dash=[5, 4], color="failed", width=1.25) for x in limits]
    bars = histogram(inside, BINS, color="measured")
    return plot(title, bars, *lines, y=axis(scale="log", low=0.8), height=170)
