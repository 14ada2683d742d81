"""Figures of a matrix: detection over severity, ROC, time to the code, confusion."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from training.limits.alarm_rules import TITLES
from training.limits.rates import Figures
from training.limits.targets import DETECTED, LIMIT_SEVERITY, MEDIAN_ENABLED_S

COLOURS = {"loop": "C0", "after": "C1"}
LABELS = {"loop": "in the loop", "after": "put on afterwards"}
COLUMNS = 3


def severity_figure(detection: Sequence[Figures]) -> Figure:
    """Draw the share detected (full) and named rightly (hollow) over severity, with bounds."""
    faults = [name for name in LIMIT_SEVERITY if any(d["fault"] == name for d in detection)]
    figure, grid = _grid(faults)
    for axes, fault in zip(grid, faults, strict=False):
        for placement, colour in COLOURS.items():
            cells = [d for d in detection if (d["fault"], d["placement"]) == (fault, placement)]
            if not cells:
                continue
            x = np.array([d["severity"] for d in cells]) * (1.02 if placement == "after" else 0.98)
            share, low, high = (
                np.array([d["detected"][k] for d in cells]) for k in ("rate", "low", "high")
            )
            axes.errorbar(
                x,
                share,
                [share - low, high - share],
                color=colour,
                marker="o",
                markersize=4,
                capsize=2,
                label=LABELS[placement],
            )
            named = [d["named"]["rate"] for d in cells]
            axes.plot(
                x,
                named,
                "o",
                color=colour,
                markersize=4,
                markerfacecolor="white",
                linestyle=":",
                linewidth=0.9,
            )
        axes.axvline(LIMIT_SEVERITY[fault], color="0.6", linewidth=0.8, linestyle="--")
        axes.axhline(DETECTED, color="0.6", linewidth=0.8, linestyle="--")
        axes.set_xscale("log")
        ticks = sorted({d["severity"] for d in detection if d["fault"] == fault})
        axes.set_xticks(ticks, [f"{t:g}" for t in ticks])
        axes.minorticks_off()
        axes.set_ylim(-0.03, 1.05)
        axes.set_title(fault.replace("_", " "), fontsize=9)
    _legend(figure, grid)
    figure.supxlabel("severity: s, gain that is left, or offset in lambda", fontsize=10)
    figure.supylabel("share of drives", fontsize=10)
    return figure


def roc_figure(curves: Sequence[Figures], placement: str) -> Figure:
    """Draw the ROC of every rule for every fault at its limit severity."""
    own = [c for c in curves if c["placement"] == placement]
    faults = list(dict.fromkeys(c["fault"] for c in own))
    figure, grid = _grid(faults)
    for axes, fault in zip(grid, faults, strict=False):
        for curve in (c for c in own if c["fault"] == fault):
            x, y = np.array(curve["points"]).reshape(-1, 2).T
            rule = curve["rule"]
            axes.plot(
                x,
                y,
                color=f"C{list(TITLES).index(rule)}",
                drawstyle="steps-post",
                linewidth=1.6 if rule in ("response", "bias") else 0.9,
                label=TITLES[rule],
            )
        axes.set(xlim=(-0.01, 0.5), ylim=(-0.03, 1.03))
        axes.set_title(fault.replace("_", " "), fontsize=9)
    _legend(figure, grid)
    figure.supxlabel("share of healthy drives above the limit (drawn to one half)", fontsize=10)
    figure.supylabel("share of faulty drives above it", fontsize=10)
    return figure


def time_figure(times: Mapping[str, Mapping[str, Sequence[float | None]]]) -> Figure:
    """Draw how many drives have a code after how much enabled driving.

    times : placement → fault → seconds of each drive, None is never
    """
    placements = [p for p in COLOURS if times.get(p)]
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    grid = figure.subplots(1, max(len(placements), 1), squeeze=False, sharey=True)[0]
    for axes, placement in zip(grid, placements, strict=False):
        for i, (fault, seconds) in enumerate(times[placement].items()):
            x = np.sort([t for t in seconds if t is not None])
            y = np.arange(1, len(x) + 1) / max(len(seconds), 1)
            axes.plot(
                np.maximum(x, 1.0),
                y,
                color=f"C{i}",
                drawstyle="steps-post",
                linewidth=1.2,
                label=fault.replace("_", " "),
            )
        axes.axvline(MEDIAN_ENABLED_S, color="0.6", linewidth=0.8, linestyle="--")
        axes.axhline(0.5, color="0.6", linewidth=0.8, linestyle="--")
        axes.set_xscale("log")
        axes.set(xlabel="s of enabled driving until the first code", ylim=(0.0, 1.02))
        axes.set_title(LABELS[placement], fontsize=9)
    grid[0].set_ylabel("share of drives")
    if placements:
        grid[-1].legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def confusion_figure(table: Mapping[str, Any]) -> Figure:
    """Draw the names given (columns) to what was driven (rows), in percent of the drives."""
    counts = np.array(table["counts"], dtype=np.float64).reshape(-1, len(table["named"]))
    share = 100.0 * counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
    figure = Figure(figsize=(9, 1.6 + 0.32 * len(counts)), layout="constrained")
    axes = figure.subplots()
    axes.imshow(share, cmap="Blues", vmin=0.0, vmax=100.0, aspect="auto")
    for i, j in zip(*np.nonzero(counts), strict=True):
        text = f"{share[i, j]:.0f}" if share[i, j] >= 1.0 else "<1"
        axes.text(
            j,
            i,
            text,
            ha="center",
            va="center",
            fontsize=7,
            color="white" if share[i, j] > 60.0 else "black",
        )
    _names(axes, table["driven"], table["named"])
    return figure


def _names(axes: Axes, driven: Sequence[str], named: Sequence[str]) -> None:
    axes.set_xticks(
        range(len(named)),
        [n.replace("_", " ") for n in named],
        rotation=60,
        ha="right",
        fontsize=8,
        rotation_mode="anchor",
    )
    axes.set_yticks(range(len(driven)), [d.replace("_", " ") for d in driven], fontsize=8)
    axes.set(xlabel="name given", ylabel="driven")


def _grid(panels: Sequence[str]) -> tuple[Figure, Sequence[Axes]]:
    rows = -(-max(len(panels), 1) // COLUMNS)
    figure = Figure(figsize=(9, 2.3 * rows + 0.6), layout="constrained")
    grid = figure.subplots(rows, COLUMNS, squeeze=False, sharey=True).ravel()
    for axes in grid[len(panels) :]:
        axes.set_axis_off()
    return figure, list(grid)


def _legend(figure: Figure, grid: Sequence[Axes]) -> None:
    handles, labels = grid[0].get_legend_handles_labels()
    if handles:
        figure.legend(
            handles, labels, loc="outside upper center", ncols=4, frameon=False, fontsize=8
        )
