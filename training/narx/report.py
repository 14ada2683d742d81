"""A self-contained HTML report of one training."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np
from matplotlib.figure import Figure

from monitor.base.types import FloatArray
from monitor.model.card import ModelCard
from monitor.model.step import from_model_units
from training.narx.fit import FitResult
from training.narx.model_file import HeldOut
from training.narx.network import describe
from training.pages.page import page, paragraph, picture, table
from training.recordings.preparation import Prepared

FIGURE_SAMPLES = 1500  # at most this many of a held-out block are drawn


class Fit(Protocol):
    """What the parts that every kind of model shares need of a fit."""

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


def write_report(path: Path | str, result: FitResult) -> None:
    """Write the report; figures are embedded, nothing is loaded from elsewhere."""
    body = "\n".join(
        [
            *(paragraph(w, "warning") for w in result.warnings),
            _overview(result),
            _tries(result),
            measures_table(result),
            picture(_training_curves(result), "Free-run validation over the epochs of each start"),
            picture(held_out_run(result), "Free run (orange) and measurement on held-out blocks"),
            picture(scatter(result), "Prediction over measurement; residuals"),
        ]
    )
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_text(page(f"Training of {result.path.name}", body))


def _overview(result: FitResult) -> str:
    card, spec = result.card, result.network.spec
    stability, parity = card.checks["contraction"], card.checks["parity"]
    rows = [
        ("inputs", ", ".join(card.input_names)),
        ("output", f"{card.output.name} [{card.output.unit or 'as recorded'}]"),
        ("sample period", f"{card.period_ns / 1e9:g} s"),
        ("shape", describe(spec)),
        ("weights", str(spec.n_weights)),
        ("samples", f"{len(result.data.role)} of {len(card.recordings)} recordings"),
        ("time", f"{result.seconds:.0f} s for {sum(t.members == 1 for t in result.starts)} starts"),
        ("trainings it is the mean of", str(result.starts[result.best].members)),
        (
            "two histories after 50 samples",
            f"differ by at most {stability['gap']:.2g} (limit {stability['limit']:.2g})",
        ),
        (
            "ONNX against numpy, free run",
            f"{parity['onnx_numpy']:.2g} (tolerance {parity['tolerance']:.2g})",
        ),
    ]
    return table(rows) + recordings_table(card)


def recordings_table(card: ModelCard) -> str:
    """Return the recordings that the model was trained on."""
    recordings = [
        (r.path, r.source or "not said", r.sha256[:16], str(r.samples)) for r in card.recordings
    ]
    return table(recordings, ("recording", "source", "sha256", "samples"))


def _tries(result: FitResult) -> str:
    if not result.tries:
        return ""
    ordered = sorted(result.tries, key=lambda t: t.rmse)
    spec = result.network.spec
    rows = [
        (
            f"{t.structure.longest}",
            str(t.structure.lags),
            ", ".join(map(str, t.structure.hidden)) or "linear",
            str(t.n_weights),
            f"{t.rmse * result.data.scaling.y_std:.4g}",
        )
        for t in ordered
    ]
    members = result.starts[result.best].members
    one = replace(spec, hidden=tuple(n // members for n in spec.hidden))
    chosen = [t.structure.spec(result.data) == one for t in ordered].index(True)
    text = paragraph(
        "Each was trained shortly. A larger structure had to be better by more than its "
        "uncertainty, so the first row need not be the choice.",
        "note",
    )
    head = ("longest input lag", "output lags", "hidden layers", "weights", "free-run RMSE")
    return f"<h2>Structures tried</h2>{text}{table(rows, head, chosen)}"


def measures_table(result: Fit) -> str:
    """Return the figures on held-out blocks."""
    names = (
        "samples",
        "fit_percent",
        "correlation",
        "slope",
        "rmse",
        "residual_mean",
        "residual_std",
    )
    rows = [
        (
            title,
            *(
                f"{result.card.fit[key].get(n, float('nan')):{'.0f' if n == 'samples' else '.4g'}}"
                for n in names
            ),
        )
        for key, title in (("test", "all held-out"), ("test_enabled", "enabled"))
    ]
    return "<h2>Free run on held-out blocks</h2>" + table(rows, ("", *names))


def _training_curves(result: FitResult) -> Figure:
    figure = Figure(figsize=(9, 3.2), layout="constrained")
    axes = figure.add_subplot()
    for index, start in enumerate(result.starts):
        at = 0
        for stage in start.stages:
            scores = np.array(stage.scores) * result.data.scaling.y_std
            axes.semilogy(np.arange(at, at + len(scores)), scores, color=f"C{index}")
            if index == result.best:
                axes.axvline(at, color="0.85", linewidth=0.8)
                label = " " + stage.name.removeprefix("horizon ")
                axes.text(
                    at,
                    0.98,
                    label,
                    transform=axes.get_xaxis_transform(),
                    va="top",
                    fontsize=8,
                    color="0.4",
                )
            at += len(scores) - 1
    axes.set(xlabel="epoch; the number is the horizon in samples", ylabel="RMSE, model units")
    return figure


def _output_units(result: Fit) -> tuple[FloatArray, FloatArray]:
    data = result.data
    measured = np.where(data.samples.weight > 0, data.scaling.unscale_y(data.samples.y), np.nan)
    return (
        from_model_units(data.transform, measured),
        from_model_units(data.transform, result.predicted),
    )


def held_out_run(result: Fit) -> Figure:
    """Draw free run and measurement on the longest held-out blocks."""
    measured, predicted = _output_units(result)
    tests = [h for h in result.held_out if h.role == "test"]
    chosen = sorted(tests, key=lambda h: h.first - h.stop)[:3]
    figure = Figure(figsize=(9, 2.4 * len(chosen)), layout="constrained")
    for axes, block in zip(
        np.atleast_1d(figure.subplots(len(chosen), 1, squeeze=False)[:, 0]), chosen, strict=True
    ):
        rows = _rows(result, block)[:FIGURE_SAMPLES]
        t_s = (block.first + np.arange(len(rows))) * result.data.period_ns / 1e9
        axes.plot(t_s, measured[rows], linewidth=0.9, color="0.2")
        axes.plot(t_s, predicted[rows], linewidth=0.9, color="C1")
        axes.set(xlabel="s", ylabel=result.card.output.name)
        axes.set_ylim(*_robust_limits(result))
    return figure


def _rows(result: Fit, block: HeldOut) -> np.ndarray:
    for s in result.data.segments:
        if s.recording == block.recording and s.first <= block.first < s.first + s.stop - s.start:
            return np.arange(s.start + block.first - s.first, s.start + block.stop - s.first)
    raise ValueError(f"{block} lies in no segment")


def _robust_limits(result: Fit) -> tuple[float, float]:
    data = result.data
    values = data.scaling.unscale_y(data.samples.y[data.enabled])
    values = from_model_units(data.transform, values)
    low, high = np.percentile(values, [0.5, 99.5])
    return float(low - 0.2 * (high - low)), float(high + 0.2 * (high - low))


def scatter(result: Fit) -> Figure:
    """Draw prediction over measurement, and the residuals, on held-out enabled samples."""
    measured, predicted = _output_units(result)
    rows = (result.data.role == 2) & result.data.enabled & np.isfinite(predicted)
    a, b = measured[rows], predicted[rows]
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    limits = _robust_limits(result)
    left.hexbin(a, b, gridsize=60, bins="log", mincnt=1, extent=(*limits, *limits), cmap="Blues")
    left.plot(limits, limits, color="0.5", linewidth=0.8)
    left.set(xlabel="measured", ylabel="predicted", xlim=limits, ylim=limits)
    residual = a - b
    width = 5 * float(residual.std()) if len(residual) else 1.0
    right.hist(np.clip(residual, -width, width), bins=100)
    right.set(xlabel="measured - predicted", ylabel="enabled held-out samples", yscale="log")
    return figure
