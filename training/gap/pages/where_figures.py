"""Pictures of where a model and a vehicle disagree."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from monitor.base.types import FloatArray
from training.gap.response.account import Curve
from training.gap.verify.evidence import Trace
from training.gap.where.bands import Bands
from training.gap.where.drivers import UNITS, WORDS
from training.gap.where.operating_map import Excerpt, OperatingMap
from training.gap.where.over_time import Change
from training.gap.where.regimes import Regime
from training.pages.figure import drawing, legend, panels
from training.pages.numbers import with_unit, words

CURVE_UNITS = {"timing": "s early", "sensitivity": "relative"}


def label(name: str) -> str:
    """Return a signal's words with its unit."""
    return with_unit(WORDS.get(name, words(name)), UNITS.get(name))


def excerpt_figure(part: Excerpt) -> Figure:
    """Draw measured and predicted phi and their difference."""
    return runs_figure(part, [(part.predicted, "C0", "predicted")])


def runs_figure(part: Excerpt | Trace, runs: Sequence[tuple[FloatArray, str, str]]) -> Figure:
    """Draw measured phi and models' runs (phi, colour, label), and the error of each."""
    figure, (top, bottom) = panels(2, 1, height=2.0, sharex=True, height_ratios=(2, 1))
    top.plot(part.t_s, part.measured, color="0.2", linewidth=1.0, label="measured")
    for phi, colour, name in runs:
        top.plot(part.t_s, phi, color=colour, linewidth=1.1, label=name)
        residual = np.where(part.scored, part.measured - phi, np.nan)
        bottom.plot(part.t_s, residual, color=colour, linewidth=1.0)
    shown = np.concatenate([x[part.scored] for x in (part.measured, *(phi for phi, _, _ in runs))])
    if len(shown):
        low, high = (float(v) for v in np.percentile(shown, [0.5, 99.5]))
        margin = 0.15 * (high - low) + 1e-4
        top.set_ylim(low - margin, high + margin)
    bottom.axhline(0.0, color="0.6", linewidth=0.7)
    for axes in (top, bottom):
        low, high = axes.get_ylim()
        axes.fill_between(part.t_s, low, high, where=~part.scored, color="0.9", step="mid", lw=0)
        axes.set_ylim(low, high)
        axes.margins(x=0)
    top.set_ylabel("phi")
    legend(top)
    bottom.set(xlabel=f"s of {part.recording}", ylabel="measured minus\npredicted [phi]")
    return figure


def map_figure(over: OperatingMap) -> Figure:
    """Draw root excess and mean residual over speed and load."""
    figure, (left, right) = panels(2, 2, height=3.4, sharey=True)
    root = np.sqrt(np.maximum(over.excess, 0.0))
    grid = (over.speed_edges, over.load_edges)
    drawn = left.pcolormesh(*grid, root, cmap="Reds", vmin=0.0)
    figure.colorbar(drawn, ax=left, label="root of the excess [phi]")
    most = float(np.nanmax(np.abs(over.mean))) if np.isfinite(over.mean).any() else 1.0
    drawn = right.pcolormesh(*grid, over.mean, cmap="RdBu_r", vmin=-most, vmax=most)
    figure.colorbar(drawn, ax=right, label="mean residual [phi], red is rich")
    left.set_ylabel(label(over.load))
    for axes in (left, right):
        axes.set_xlabel(label(over.speed))
        axes.set_facecolor("0.93")
    return figure


def regime_figure(regimes: Sequence[Regime]) -> Figure:
    """Draw shares of the excess with their bounds."""
    figure, axes = drawing(0.5 + 0.32 * len(regimes))
    at = np.arange(len(regimes))
    shares = np.array([[r.share.low, r.share.value, r.share.high] for r in regimes]) * 100.0
    axes.barh(at, shares[:, 1], color="C0", height=0.7)
    spread = [shares[:, 1] - shares[:, 0], shares[:, 2] - shares[:, 1]]
    axes.errorbar(shares[:, 1], at, xerr=spread, fmt="none", ecolor="0.3", elinewidth=1.0)
    axes.set_yticks(at, [f"{r.words}, {r.point}" for r in regimes])
    axes.invert_yaxis()
    axes.set(xlabel="share of the excess squared error in held-out blocks [%]", xlim=(0, 105))
    return figure


def curve_figure(regimes: Sequence[Regime]) -> Figure:
    """Draw how the excess depends on each driver that has a curve."""
    with_curve = [r for r in regimes if r.curve is not None]
    figure, grid = panels(len(with_curve), len(with_curve), height=2.9)
    for axes, r in zip(grid, with_curve, strict=True):
        c = r.curve
        assert c is not None
        axes.fill_between(c.x, c.low, c.high, color="C0", alpha=0.25, linewidth=0)
        axes.plot(c.x, c.y, color="C0", linewidth=1.2)
        axes.axhline(0.0, color="0.5", linewidth=0.7)
        axes.set_title(r.point)
        axes.set_xlabel(with_unit(r.words, r.unit))
        axes.set_ylabel(f"excess [{CURVE_UNITS.get(r.point, 'phi')}]")
    return figure


def added_figure(curve: Curve, driver: str, unit: str) -> Figure:
    """Draw what a driver adds to the reading."""
    figure, axes = drawing(2.6)
    axes.plot(curve.x, curve.y, color="C0", linewidth=1.2)
    axes.axhline(0.0, color="0.5", linewidth=0.7)
    axes.set(xlabel=label(driver), ylabel=f"added [{unit}]")
    return figure


def band_figure(found: Bands) -> Figure:
    """Draw the spectrum beside its reference, and the coherence with each input."""
    figure, (left, right) = panels(2, 2, height=3.4)
    left.loglog(found.frequency_hz, found.density, color="C3", linewidth=1.0, label="residual")
    left.loglog(found.frequency_hz, found.reference, color="0.3", linewidth=1.0, label="reference")
    left.set(xlabel="Hz", ylabel="phi² per Hz")
    left.legend()
    drawn = right.imshow(found.coherence.T, aspect="auto", cmap="Blues", vmin=0.0)
    figure.colorbar(drawn, ax=right, label="coherence")
    clear = np.argwhere(found.p_values < 0.01)
    right.plot(clear[:, 0], clear[:, 1], ".", color="C3", markersize=4)
    right.set_yticks(range(len(found.names)), [WORDS.get(n, n) for n in found.names])
    names = [f"{b.low_hz:.2g}–{b.high_hz:.2g}" for b in found.bands]
    right.set_xticks(range(len(names)), names, rotation=45, ha="right")
    right.set_xlabel("band [Hz]")
    return figure


def time_figure(changes: Sequence[Change]) -> Figure:
    """Draw the residual in blocks over each recording, and its cumulative sum."""
    rows = len(changes)
    figure, grid = panels(2 * rows, 2, height=1.5, extra=0.6)
    for left, right, c in zip(grid[::2], grid[1::2], changes, strict=True):
        colour = "C3" if c.significant else "C0"
        left.plot(c.block_s, c.blocks, drawstyle="steps-mid", color=colour, linewidth=1.0)
        for start, stop, value in (
            (c.block_s[0], c.t_s, c.before),
            (c.t_s, c.block_s[-1], c.after),
        ):
            left.plot([start, stop], [value, value], color="0.2", linewidth=1.0)
        left.set_title(f"{c.recording}: {c.quantity}", loc="left")
        right.plot(c.block_s, c.cumulative, color=colour, linewidth=1.0)
        right.axvline(c.t_s, color="0.2", linestyle="--", linewidth=0.8)
        right.set_title("cumulative sum", loc="left")
    figure.supxlabel("s of the recording")
    return figure
