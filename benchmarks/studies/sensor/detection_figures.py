"""Figures of a matrix: detection over severity, ROC, time to the code, confusion."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.studies.rules.alarms import TITLES
from benchmarks.studies.sensor.goals import DETECTED, LIMIT_SEVERITY, MEDIAN_ENABLED_S
from training.limits.rates import Figures
from training.pages.figure import LIMIT, drawing, legend, panels
from training.pages.numbers import words

COLOURS = {"loop": "C0", "after": "C1"}
LABELS = {"loop": "in the loop", "after": "put on afterwards"}
COLUMNS = 3


def severity_figure(detection: Sequence[Figures]) -> Figure:
    """Draw the share detected (full) and named rightly (hollow) over severity, with bounds."""
    faults = [name for name in LIMIT_SEVERITY if any(d["fault"] == name for d in detection)]
    figure, grid = panels(len(faults), COLUMNS, height=2.3, extra=0.6, sharey=True)
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
        axes.axvline(LIMIT_SEVERITY[fault], color=LIMIT, linewidth=0.8, linestyle="--")
        axes.axhline(DETECTED, color=LIMIT, linewidth=0.8, linestyle="--")
        axes.set_xscale("log")
        ticks = sorted({d["severity"] for d in detection if d["fault"] == fault})
        axes.set_xticks(ticks, [f"{t:g}" for t in ticks])
        axes.minorticks_off()
        axes.set_ylim(-0.03, 1.05)
        axes.set_title(words(fault))
    _legend(figure, grid)
    figure.supxlabel("severity: s, gain that is left, or offset in lambda")
    figure.supylabel("share of drives")
    return figure


def roc_figure(curves: Sequence[Figures], placement: str) -> Figure:
    """Draw the ROC of every rule for every fault at its limit severity."""
    own = [c for c in curves if c["placement"] == placement]
    faults = list(dict.fromkeys(c["fault"] for c in own))
    figure, grid = panels(len(faults), COLUMNS, height=2.3, extra=0.6, sharey=True)
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
        axes.set_title(words(fault))
    _legend(figure, grid)
    figure.supxlabel("share of healthy drives above the limit (drawn to one half)")
    figure.supylabel("share of faulty drives above it")
    return figure


def time_figure(times: Mapping[str, Mapping[str, Sequence[float | None]]]) -> Figure:
    """Draw how many drives have a code after how much enabled driving.

    times : placement → fault → seconds of each drive, None is never
    """
    placements = [p for p in COLOURS if times.get(p)]
    figure, grid = panels(len(placements), max(len(placements), 1), height=3.8, sharey=True)
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
                label=words(fault),
            )
        axes.axvline(MEDIAN_ENABLED_S, color=LIMIT, linewidth=0.8, linestyle="--")
        axes.axhline(0.5, color=LIMIT, linewidth=0.8, linestyle="--")
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:g}")
        axes.set(xlabel="s of enabled driving until the first code", ylim=(0.0, 1.02))
        axes.set_title(LABELS[placement])
    if placements:
        grid[0].set_ylabel("share of drives")
        legend(grid[-1], "beside")
    return figure


def confusion_figure(table: Mapping[str, Any]) -> Figure:
    """Draw the names given (columns) to the driven faults (rows), in percent of the drives."""
    counts = np.array(table["counts"], dtype=np.float64).reshape(-1, len(table["named"]))
    share = 100.0 * counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
    figure, axes = drawing(1.6 + 0.32 * len(counts))
    axes.imshow(share, cmap="Blues", vmin=0.0, vmax=100.0, aspect="auto")
    for i, j in zip(*np.nonzero(counts), strict=True):
        text = f"{share[i, j]:.0f}" if share[i, j] >= 1.0 else "<1"
        axes.text(
            j,
            i,
            text,
            ha="center",
            va="center",
            size=7,
            color="white" if share[i, j] > 60.0 else "black",
        )
    _names(axes, table["driven"], table["named"])
    return figure


def _names(axes: Axes, driven: Sequence[str], named: Sequence[str]) -> None:
    axes.set_xticks(
        range(len(named)),
        [words(n) for n in named],
        rotation=60,
        ha="right",
        rotation_mode="anchor",
    )
    axes.set_yticks(range(len(driven)), [words(d) for d in driven])
    axes.set(xlabel="name given", ylabel="driven")


def _legend(figure: Figure, grid: Sequence[Axes]) -> None:
    handles, labels = grid[0].get_legend_handles_labels() if grid else ((), ())
    if handles:
        figure.legend(handles, labels, loc="outside upper center", ncols=4)
