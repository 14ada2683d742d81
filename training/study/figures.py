"""Figures of the study: spectrum, components, impulse responses, models, sensor and residuals."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from monitor.base.types import FloatArray
from training.pages.drawing import Drawing, Layer, Plot, axis, layer, plot, unscored
from training.pages.heat import LEVELS, Heat, HeatCell
from training.pages.numbers import with_unit, words
from training.study.narx.verdicts import ROLES, correlations, errors

Result = Mapping[str, Any]

LINES: Final = {"noise": "failed", "commanded": "passed", "driven": "predicted"}
R_TICKS: Final = (0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.998, 0.999, 0.9995, 0.9999)
LOOKS: Final = {
    "train": (-0.22, "measured"),
    "validate": (0.0, "predicted"),
    "test": (0.22, "passed"),
}
R_FLOOR: Final = 0.5  # correlations below are drawn at the left end
MODES: Final = {
    "one_step": ("one step ahead", -0.15, "band"),
    "free_run": ("free run (closed loop)", 0.15, "measured"),
}
ROW: Final = 20  # px
DASHED: Final = {"color": "quiet", "dash": [5, 4]}


def spectrum_figure(result: Result) -> Drawing:
    """Draw the output's spectrum with its lines, and its coherence with the inputs."""
    spectrum, output = result["spectrum"], result["output"]
    f = np.array(spectrum["frequency_hz"])[1:-1]
    unit = "1/Hz" if result["transform"] == "phi" else "unit²/Hz"
    lines = [x for x in result["lines"] if x["signal"] == output]
    bands = []
    for kind, color in LINES.items():
        own = [[x["low_hz"], x["high_hz"]] for x in lines if x["kind"] == kind]
        bands += [layer("spans", x=own, color=color, label=f"line, {kind}")] if own else []
    density = np.array(spectrum["density"][output][1:-1])
    background = _array(spectrum["background"][1:-1])
    upper = plot(
        f"power spectral density, {unit}",
        *bands,
        layer("line", y=background, label="background", color="band"),
        layer("line", y=density, label="spectrum of the output", color="measured"),
        y=axis(scale="log"),
        at=f,
        height=220,
    )
    peaks = [(max(v[4:-2], default=0.0), name) for name, v in spectrum["coherence"].items()]
    coherent = [
        layer("line", y=_array(spectrum["coherence"][name][1:-1]), label=name, color=i)
        for i, (_, name) in enumerate(sorted(peaks, reverse=True)[:4])
    ]
    lower = plot(
        "coherence with the output; dashed: unrelated signals stay below in 95 %",
        layer("rule", y=[spectrum["coherence_limit"]], **DASHED),
        *coherent,
        x=axis("frequency, Hz"),
        y=axis(low=0.0, high=1.02),
        at=f,
        height=160,
    )
    return Drawing([upper, lower], together=True)


def scree_figure(result: Result) -> Drawing:
    """Draw the variances of the components."""
    edges = np.arange(len(result["variances"]) + 1) + 0.5
    bars = layer("steps", x=edges, y=result["variances"], color="measured")
    kept = layer("rule", x=[result["kept"] + 0.5], **DASHED)
    over = axis("component; kept ones left of the dashed line")
    return Drawing([plot("variance", bars, kept, x=over, y=axis(low=0.0))])


def loadings(result: Result) -> Heat:
    """Return the loadings of the kept components and the first left out, deeper if larger."""
    n = min(result["kept"] + 1, len(result["variances"]))
    rows = [
        (name, [HeatCell(f"{v:.2f}", level=round(LEVELS * min(abs(v), 1.0))) for v in row[:n]])
        for name, row in zip(result["names"], result["loadings"], strict=True)
    ]
    return Heat("loading on component", [str(i + 1) for i in range(n)], rows)


def impulse_figure(result: Result) -> Drawing:
    """Draw the impulse responses with their 99 % bands."""
    plots = []
    for row in result["impulse"]["rows"]:
        t_s = np.arange(len(row["response"])) * result["period_s"]
        band = _array(row["band"])
        outline = {"x": np.concatenate([t_s, t_s[::-1]]), "y": np.concatenate([band, -band[::-1]])}
        delays = [] if row["delay"] is None else [row["delay"] * result["period_s"]]
        response = _array(row["response"])
        plots.append(
            plot(
                row["input"],
                layer("area", **outline, color="band", alpha=0.3),
                layer("rule", x=delays, color="failed", dash=[5, 4]),
                layer("line", y=response, color="measured"),
                layer("points", x=t_s, y=response, size=1.5, color="measured"),
                x=axis("s after a pulse of one sample"),
                at=t_s,
                height=150,
            )
        )
    return Drawing(plots, columns=(1,) * min(3, len(plots)))


def correlation_figure(result: Result) -> Drawing:
    """Draw R of training, validation and test and the MSE of every model, as the paper does."""
    models = [m for m in result["models"] if m["same_as"] is None]
    height = 40 + ROW * len(models)
    names = axis(rows=[f"{m['number']}  {m['name']}" for m in models])
    numbers = axis(rows=[str(m["number"]) for m in models])
    plots: list[Plot] = []
    for mode, (title, _, _) in MODES.items():
        own, smallest = _correlations(models, mode)
        ticks = [(1.0 - t, f"{t:g}") for t in R_TICKS if 1.0 - t > 0.7 * smallest]
        low, high = 0.7 * smallest, 1.1 * (1.0 - R_FLOOR)
        over = axis("R", scale="log", ticks=ticks, falls=True, low=low, high=high)
        plots.append(plot(title, *own, x=over, y=numbers if plots else names, height=height))
    squares = []
    for mode, (title, shift, color) in MODES.items():
        values = np.array([np.median(errors(m, mode, "test") ** 2) for m in models])
        y = np.arange(len(models)) + shift
        squares.append(layer("points", x=values, y=y, label=title, color=color))
    over = axis("MSE of the test blocks, scaled", scale="log")
    plots.append(plot("mean squared error", *squares, x=over, y=numbers, height=height))
    return Drawing(plots, columns=(3, 2, 2))


def _correlations(models: Sequence[Result], mode: str) -> tuple[list[Layer], float]:
    """Return layers over 1 - R, since good models differ only there, and the smallest 1 - R."""
    smallest, layers = 1.0, []
    for role, (shift, color) in LOOKS.items():
        below = [1 - np.nan_to_num(correlations(m, mode, role)) for m in models]
        below = [np.clip(v, 1e-6, 1 - R_FLOOR) for v in below]
        middle, low, high = (np.array([f(v) for v in below]) for f in (np.median, np.min, np.max))
        at = np.arange(len(models)) + shift
        gap = np.full(len(models), np.nan)
        x, y = np.column_stack([low, high, gap]).ravel(), np.column_stack([at, at, gap]).ravel()
        layers.append(layer("line", x=x, y=y, color=color))
        layers.append(layer("points", x=middle, y=at, label=ROLES[role], color=color, size=2.5))
        smallest = min(smallest, float(low.min()))
    return layers, smallest


def sensor_figure(views: Sequence[Result], sensor: Result) -> Drawing:
    """Draw an excerpt and a scatter of each view, as figure 6 of the paper."""
    return Drawing([each for view in views for each in _view(view, sensor)], columns=(7, 3))


def label(result: Result) -> str:
    """Return the output's name and unit for an axis."""
    return with_unit(result["output"], result["unit"])


def _array(values: Sequence[float | None]) -> FloatArray:
    return np.array(values, dtype=np.float64)  # NaN where JSON has null


def _view(view: Result, result: Result) -> Iterator[Plot]:
    """Yield sensor and model over time, samples that are not judged on grey, and their scatter."""
    judged = np.array(view["judged"], dtype=bool)
    measured, predicted = (_array(view["excerpt"][key]) for key in ("measured", "predicted"))
    t_s = np.arange(len(judged)) * result["period_s"]
    inside = np.concatenate([values[judged | ~judged.any()] for values in (measured, predicted)])
    low, high = _inner(inside, 0.01, 0.35)
    yield plot(
        f"{view['title']} ({view['source']}), {label(result)}",
        unscored(t_s, judged),
        layer("line", y=predicted, label="model, free run", color="predicted"),
        layer("line", y=measured, label="sensor", color="measured"),
        x=axis("s of the excerpt"),
        y=axis(low=low, high=high),
        at=t_s,
        height=170,
    )
    x, y = (_array(view["scatter"][k]) for k in ("measured", "predicted"))
    r = view["enabled"].get("correlation")
    low, high = _inner(np.concatenate([x, y]), 0.005, 0.1)
    yield plot(
        "predicted" if r is None else f"predicted, R = {r:.3f}",
        layer("points", x=x, y=y, size=1.2, alpha=0.4, color="measured"),
        layer("line", x=[low, high], y=[low, high], color="quiet"),
        x=axis("measured", low=low, high=high),
        y=axis(low=low, high=high),
        height=170,
    )


def _inner(values: FloatArray, tail: float, room: float) -> tuple[float | None, float | None]:
    """Return the bounds of an axis that leaves out ``tail`` at each end, and gives it room."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return None, None
    low, high = np.quantile(finite, [tail, 1.0 - tail]).tolist()
    margin = room * max(high - low, 1e-9)
    return low - margin, high + margin


def residual_figure(sensor: Result) -> Drawing:
    """Draw the residual's distribution under each fault over the healthy one, as figure 7."""
    faults, edges, healthy = sensor["faults"], sensor["edges"], sensor["healthy"]["share"]
    j_mu = sensor["limits"].get("j_mu")
    limits = layer("rule", x=[] if j_mu is None else [-j_mu, j_mu], color="quiet", dash=[2, 3])
    shares = [v for each in (healthy, *(fault["share"] for fault in faults)) for v in each if v]
    plots = [
        plot(
            words(fault["name"]),
            layer("steps", x=edges, y=healthy, label="healthy", color="band", alpha=0.6),
            layer("steps", x=edges, y=fault["share"], label="faulty", color="failed", alpha=0.5),
            limits,
            x=axis(f"measured − predicted {label(sensor)}"),
            y=axis(scale="log", low=0.5 * min(shares), high=1.3 * max(shares)),
            height=150,
        )
        for fault in faults
    ]
    return Drawing(plots, columns=(1,) * min(3, len(faults)))
