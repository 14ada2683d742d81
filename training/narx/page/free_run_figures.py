"""Figures of a fit: free run and measurement on held-out blocks, prediction over measurement."""

from pathlib import Path

import numpy as np

from monitor.base.runs import runs
from monitor.model.step import from_model_units
from training.narx.model_file import FreeRunFit
from training.pages.drawing import Drawing, axis, density, histogram, layer, plot
from training.pages.numbers import with_unit
from training.recordings.samples.preparation import Prepared, Role, Segment

FIGURE_SAMPLES = 1500  # at most this many of a held-out block are drawn


def held_out_run(result: FreeRunFit) -> Drawing:
    """Draw free run and measurement on the longest held-out blocks."""
    measured, predicted = result.in_units
    chosen = sorted(measured_blocks(result.data), key=lambda block: block[1] - block[2])[:3]
    low, high = _robust_limits(result)
    plots = []
    for segment, first, stop in chosen:
        rows = np.arange(first, min(stop, first + FIGURE_SAMPLES))
        plots.append(
            plot(
                with_unit(result.card.output.name, result.card.output.unit),
                layer("line", y=predicted[rows], label="model, free run", color="predicted"),
                layer("line", y=measured[rows], label="measured", color="measured"),
                x=axis(f"s of {Path(result.card.recordings[segment.recording].path).name}"),
                y=axis(low=low, high=high),
                at=(segment.first + rows - segment.start) * result.data.period_ns / 1e9,
            )
        )
    return Drawing(plots)


def measured_blocks(data: Prepared) -> list[tuple[Segment, int, int]]:
    """Return the stretches that measure, samples first .. stop - 1, each with its segment."""
    return [
        (segment, segment.start + first, segment.start + stop)
        for segment in data.segments
        for first, stop in runs(data.role[segment.start : segment.stop] == Role.TEST)
    ]


def _robust_limits(result: FreeRunFit) -> tuple[float, float]:
    data = result.data
    rows = data.enabled if data.enabled.any() else data.samples.weight > 0
    values = from_model_units(data.transform, data.scaling.unscale_y(data.samples.y[rows]))
    low, high = np.percentile(values, [0.5, 99.5])
    return float(low - 0.2 * (high - low)), float(high + 0.2 * (high - low))


def scatter(result: FreeRunFit) -> Drawing:
    """Draw prediction over measurement, and the residuals, on held-out enabled samples."""
    measured, predicted = result.in_units
    rows = (result.data.role == Role.TEST) & result.data.enabled & np.isfinite(predicted)
    a, b = measured[rows], predicted[rows]
    low, high = _robust_limits(result)
    ends, residual = np.array([low, high]), a - b
    output = with_unit(result.card.output.name, result.card.output.unit)
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
