"""Figures of a fit: free run and measurement on held-out blocks, prediction over measurement."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from matplotlib.figure import Figure

from monitor.base.types import FloatArray
from monitor.model.card import ModelCard
from monitor.model.step import from_model_units
from training.narx.model_file import HeldOut
from training.pages.figure import LIMIT, MEASURED, legend, panels
from training.pages.numbers import with_unit
from training.recordings.samples.preparation import Prepared

FIGURE_SAMPLES = 1500  # at most this many of a held-out block are drawn


class FreeRunFit(Protocol):
    """The parts of a fit that every kind of model has."""

    @property
    def card(self) -> ModelCard:
        """The model's card."""

    @property
    def data(self) -> Prepared:
        """The samples."""

    @property
    def predicted(self) -> FloatArray:
        """Free run (n,) in model units."""

    @property
    def held_out(self) -> Sequence[HeldOut]:
        """Rows that were not trained on."""


def output_units(result: FreeRunFit) -> tuple[FloatArray, FloatArray]:
    """Return measurement and free run (n,) in the output's unit; NaN where there is none."""
    data = result.data
    measured = np.where(data.samples.weight > 0, data.scaling.unscale_y(data.samples.y), np.nan)
    return (
        from_model_units(data.transform, measured),
        from_model_units(data.transform, result.predicted),
    )


def held_out_run(result: FreeRunFit) -> Figure:
    """Draw free run and measurement on the longest held-out blocks."""
    measured, predicted = output_units(result)
    tests = [h for h in result.held_out if h.role == "test"]
    chosen = sorted(tests, key=lambda h: h.first - h.stop)[:3]
    figure, grid = panels(len(chosen), 1, height=2.4)
    for axes, block in zip(grid, chosen, strict=True):
        rows = rows_of(result, block)[:FIGURE_SAMPLES]
        t_s = (block.first + np.arange(len(rows))) * result.data.period_ns / 1e9
        axes.plot(t_s, measured[rows], linewidth=0.9, color=MEASURED, label="measured")
        axes.plot(t_s, predicted[rows], linewidth=0.9, color="C1", label="model, free run")
        axes.set(ylabel=_label(result), ylim=_robust_limits(result))
        axes.margins(x=0)
    grid[-1].set_xlabel("s of the recording")
    legend(grid[0])
    return figure


def rows_of(result: FreeRunFit, block: HeldOut) -> np.ndarray:
    """Return the rows of a held-out block among the samples of the fit."""
    for s in result.data.segments:
        if s.recording == block.recording and s.first <= block.first < s.first + s.stop - s.start:
            return np.arange(s.start + block.first - s.first, s.start + block.stop - s.first)
    raise ValueError(f"{block} lies in no segment")


def _robust_limits(result: FreeRunFit) -> tuple[float, float]:
    data = result.data
    values = data.scaling.unscale_y(data.samples.y[data.enabled])
    values = from_model_units(data.transform, values)
    low, high = np.percentile(values, [0.5, 99.5])
    return float(low - 0.2 * (high - low)), float(high + 0.2 * (high - low))


def scatter(result: FreeRunFit) -> Figure:
    """Draw prediction over measurement, and the residuals, on held-out enabled samples."""
    measured, predicted = output_units(result)
    rows = (result.data.role == 2) & result.data.enabled & np.isfinite(predicted)
    a, b = measured[rows], predicted[rows]
    figure, (left, right) = panels(2, 2, height=3.6)
    limits = _robust_limits(result)
    left.hexbin(a, b, gridsize=60, bins="log", mincnt=1, extent=(*limits, *limits), cmap="Blues")
    left.plot(limits, limits, color=LIMIT, linewidth=0.8)
    output = _label(result)
    left.set(xlabel=f"measured {output}", ylabel=f"predicted {output}", xlim=limits, ylim=limits)
    residual = a - b
    width = 5 * float(residual.std()) if len(residual) else 1.0
    right.hist(np.clip(residual, -width, width), bins=100)
    right.set(
        xlabel=f"measured − predicted {output}", ylabel="enabled held-out samples", yscale="log"
    )
    return figure


def _label(result: FreeRunFit) -> str:
    return with_unit(result.card.output.name, result.card.output.unit)
