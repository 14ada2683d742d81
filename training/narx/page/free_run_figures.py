"""Figures of a fit: free run and measurement on held-out blocks, prediction over measurement."""

from pathlib import Path

import numpy as np

from monitor.base.types import FloatArray
from monitor.model.step import from_model_units
from training.narx.model_file import FreeRunFit, HeldOut
from training.pages.drawing import Drawing, axis, density, histogram, layer, plot
from training.pages.numbers import with_unit

FIGURE_SAMPLES = 1500  # at most this many of a held-out block are drawn


def output_units(result: FreeRunFit) -> tuple[FloatArray, FloatArray]:
    """Return measurement and free run (n,) in the output's unit; NaN where there is none."""
    data = result.data
    measured = np.where(data.samples.weight > 0, data.scaling.unscale_y(data.samples.y), np.nan)
    return (
        from_model_units(data.transform, measured),
        from_model_units(data.transform, result.predicted),
    )


def held_out_run(result: FreeRunFit) -> Drawing:
    """Draw free run and measurement on the longest held-out blocks."""
    measured, predicted = output_units(result)
    tests = [h for h in result.held_out if h.role == "test"]
    chosen = sorted(tests, key=lambda h: h.first - h.stop)[:3]
    low, high = _robust_limits(result)
    plots = []
    for block in chosen:
        rows = rows_of(result, block)[:FIGURE_SAMPLES]
        plots.append(
            plot(
                _label(result),
                layer("line", y=predicted[rows], label="model, free run", color="predicted"),
                layer("line", y=measured[rows], label="measured", color="measured"),
                x=axis(f"s of {Path(result.card.recordings[block.recording].path).name}"),
                y=axis(low=low, high=high),
                at=(block.first + np.arange(len(rows))) * result.data.period_ns / 1e9,
            )
        )
    return Drawing(plots)


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


def scatter(result: FreeRunFit) -> Drawing:
    """Draw prediction over measurement, and the residuals, on held-out enabled samples."""
    measured, predicted = output_units(result)
    rows = (result.data.role == 2) & result.data.enabled & np.isfinite(predicted)
    a, b = measured[rows], predicted[rows]
    low, high = _robust_limits(result)
    ends, output, residual = np.array([low, high]), _label(result), a - b
    width = 5.0 * float(residual.std()) if len(residual) else 1.0
    over = plot(
        f"predicted {output}",
        density(a, b, low, high),
        layer("line", x=ends, y=ends, color="quiet"),
        x=axis(f"measured {output}", low=low, high=high),
        y=axis(low=low, high=high),
        height=300,
    )
    spread = plot(
        "enabled held-out samples",
        histogram(np.clip(residual, -width, width), bins=100),
        x=axis(f"measured − predicted {output}"),
        y=axis(scale="log", low=0.8),
        height=300,
    )
    return Drawing([over, spread], columns=(1, 1))


def _label(result: FreeRunFit) -> str:
    return with_unit(result.card.output.name, result.card.output.unit)
