"""Pictures of how much a new model helps, and of how candidates rank."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from training.gap.name.verdict import Candidate
from training.gap.verify.evidence import Error, ErrorTrace
from training.gap.verify.operating_map import OperatingMap
from training.pages.figure import drawing, legend, panels
from training.pages.numbers import percent

BEFORE, AFTER, FLOOR, WORSE = "0.55", "C0", "0.15", "C3"


def error_figure(errors: Sequence[Error]) -> Figure:
    """Draw RMSE before and after, and the floor, one row for each regime."""
    figure, axes = drawing(0.9 + 0.27 * len(errors))
    for at, e in enumerate(errors):
        if e.after is not None:
            axes.plot([e.before, e.after], [at, at], color="0.8", linewidth=2.0, zorder=1)
            axes.plot(e.after, at, "o", color=WORSE if e.worse else AFTER, markersize=6, zorder=3)
        axes.plot(e.before, at, "o", color=BEFORE, markersize=6, zorder=2)
        if e.floor is not None:
            axes.plot(e.floor, at, "|", color=FLOOR, markersize=13, markeredgewidth=1.6, zorder=4)
    for label, mark, colour in (
        ("before", "o", BEFORE),
        ("after", "o", AFTER),
        ("after, worse beyond confidence", "o", WORSE),
        ("noise floor", "|", FLOOR),
    ):
        drawn = not label.startswith("after") or any(
            e.after is not None and e.worse == label.startswith("after,") for e in errors
        )
        if drawn:
            axes.plot([], [], mark, color=colour, label=label, markeredgewidth=1.6)
    changes = [i for i in range(1, len(errors)) if errors[i].kind != errors[i - 1].kind]
    for i in changes:
        axes.axhline(i - 0.5, color="0.85", linewidth=0.8)
    axes.set_yticks(range(len(errors)), [e.regime for e in errors])
    axes.set_ylim(len(errors) - 0.4, -0.6)
    axes.set_xlim(left=0.0)
    axes.set_xlabel("RMSE [phi]")
    legend(axes)
    return figure


def trace_figure(trace: ErrorTrace) -> Figure:
    """Draw measured phi and both models, and both residuals."""
    figure, (top, bottom) = panels(2, 1, height=2.0, sharex=True, height_ratios=(2, 1))
    top.plot(trace.t_s, trace.measured, color="0.2", linewidth=1.0, label="measured")
    for phi, colour, name in (
        (trace.before, BEFORE, "model before"),
        (trace.after, AFTER, "model after"),
    ):
        top.plot(trace.t_s, phi, color=colour, linewidth=1.1, label=name)
        residual = np.where(trace.scored, trace.measured - phi, np.nan)
        bottom.plot(trace.t_s, residual, color=colour, linewidth=1.0)
    runs = (trace.measured, trace.before, trace.after)
    shown = np.concatenate([x[trace.scored] for x in runs])
    if len(shown):
        low, high = (float(v) for v in np.percentile(shown, [0.5, 99.5]))
        margin = 0.15 * (high - low) + 1e-4
        top.set_ylim(low - margin, high + margin)
    bottom.axhline(0.0, color="0.6", linewidth=0.7)
    for axes in (top, bottom):
        low, high = axes.get_ylim()
        axes.fill_between(trace.t_s, low, high, where=~trace.scored, color="0.9", step="mid", lw=0)
        axes.set_ylim(low, high)
        axes.margins(x=0)
    top.set_ylabel("phi")
    legend(top)
    bottom.set(xlabel=f"s of {trace.recording}", ylabel="measured minus\npredicted [phi]")
    return figure


def map_figure(over: OperatingMap) -> Figure:
    """Draw the error of both models over speed and load, in the same colours."""
    shown = [("model before", over.before)]
    shown += [] if over.after is None else [("model after", over.after)]
    figure, every = panels(len(shown), 2, height=3.4, sharey=True)
    errors = np.concatenate([error.ravel() for _, error in shown])
    most = float(np.nanmax(errors)) if np.isfinite(errors).any() else 1.0
    for axes, (title, error) in zip(every, shown, strict=True):
        drawn = axes.pcolormesh(
            over.speed_rpm, over.load_mg, error, cmap="Reds", vmin=0.0, vmax=most
        )
        axes.set_title(title)
        axes.set_xlabel("engine speed [1/min]")
        axes.set_facecolor("0.93")
    every[0].set_ylabel("air per stroke [mg]")
    figure.colorbar(drawn, ax=every, label="RMSE [phi]")
    return figure


def ranking_figure(ranking: Sequence[Candidate], chosen: Sequence[str]) -> Figure:
    """Draw the scores, effects and sensor faults in their colours, the chosen ones in full."""
    figure, axes = drawing(0.7 + 0.24 * len(ranking))
    colours = {"effect": "C0", "sensor fault": "C1"}
    for at, c in enumerate(ranking):
        score, win = c.merit.score, c.merit.win
        alpha = 1.0 if c.name in chosen else 0.45
        axes.barh(at, score, color=colours[c.kind], alpha=alpha, height=0.72)
        words = "" if win is None else f"  beaten in {percent(win)} of draws"
        axes.annotate(
            words,
            (max(score, 0.0), at),
            va="center",
            size=7,
            color="0.35",
            xytext=(2, 0),
            textcoords="offset points",
        )
    for kind, colour in colours.items():
        if any(c.kind == kind for c in ranking):
            axes.barh([0], [0], color=colour, label=kind)
    axes.axvline(0.0, color="0.4", linewidth=0.8)
    axes.set_yticks(range(len(ranking)), [c.name for c in ranking])
    axes.invert_yaxis()
    axes.margins(x=0.22)
    axes.set_xlim(left=min(0.0, *(c.merit.score for c in ranking)))
    axes.set_xlabel("score: fall of the deviance on held-out blocks")
    axes.legend(loc="lower right")
    return figure
