"""Figures of the study: spectrum, components, impulse responses, models, sensor and residuals."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from monitor.base.types import FloatArray
from training.pages.figure import LIMIT, MEASURED, legend, panels
from training.pages.numbers import with_unit, words
from training.study.narx.candidates import BAYES, DESCENT
from training.study.narx.verdicts import ROLES, correlations, errors

Result = Mapping[str, Any]

LINES = {"noise": "C3", "commanded": "C2", "driven": "C8"}
R_TICKS = (0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.998, 0.999, 0.9995, 0.9999)
LOOKS = {"train": (-0.22, "o", "C0"), "validate": (0.0, "s", "C1"), "test": (0.22, "^", "C2")}
R_FLOOR = 0.5  # correlations below are drawn at the lower edge
MODES = {
    "one_step": ("one step ahead", -0.2, "#9db8d9"),
    "free_run": ("free run (closed loop)", 0.2, "C0"),
}
PAPER_RULE: Any = {"color": "0.3", "linewidth": 0.8, "linestyle": ":"}


def spectrum_figure(result: Result) -> Figure:
    """Draw the output's spectrum with its lines, and its coherence with the inputs."""
    spectrum, output = result["spectrum"], result["output"]
    f = np.array(spectrum["frequency_hz"])[1:-1]
    figure, (upper, lower) = panels(2, 1, height=2.8, sharex=True, height_ratios=(3, 2))
    unit = "1/Hz" if result["transform"] == "phi" else "unit²/Hz"
    density = spectrum["density"][output][1:-1]
    upper.semilogy(f, density, lw=1.0, color="C0", label="spectrum of the output")
    upper.semilogy(f, spectrum["background"][1:-1], lw=1.0, color=LIMIT, label="background")
    seen = set[str]()
    for line in (x for x in result["lines"] if x["signal"] == output):
        kind = line["kind"]
        label = None if kind in seen else f"line, {kind}"
        upper.axvspan(line["low_hz"], line["high_hz"], color=LINES[kind], alpha=0.35, label=label)
        seen.add(kind)
    upper.set_ylabel(f"power spectral density, {unit}")
    upper.legend()
    peaks = [(max(v[4:-2], default=0.0), name) for name, v in spectrum["coherence"].items()]
    for _, name in sorted(peaks, reverse=True)[:4]:
        lower.plot(f, spectrum["coherence"][name][1:-1], lw=1.0, label=name)
    lower.axhline(spectrum["coherence_limit"], color=LIMIT, lw=0.8, ls="--")
    lower.set(ylim=(0.0, 1.02), ylabel="coherence with the output")
    lower.set_xlabel("frequency, Hz; dashed: unrelated signals stay below in 95 %")
    lower.legend(ncols=2)
    return figure


def scree_figure(result: Result) -> Figure:
    """Return variances and loadings of the components."""
    figure, (left, right) = panels(2, 2, height=4.0, width_ratios=(2, 3))
    number = np.arange(1, len(result["variances"]) + 1)
    left.bar(number, result["variances"], color="C0", alpha=0.5)
    left.axvline(result["kept"] + 0.5, color=LIMIT, ls="--", lw=0.8)
    left.set_xticks(number)
    left.set(xlabel="component; kept ones left of the dashed line", ylabel="variance")
    n = min(result["kept"] + 1, len(number))
    values = np.array(result["loadings"])[:, :n]
    image = right.imshow(values, cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
    right.set_yticks(range(len(result["names"])), result["names"])
    right.set_xticks(range(n), [str(i + 1) for i in range(n)])
    for (i, j), value in np.ndenumerate(values):
        ink = "white" if abs(value) > 0.6 else "black"
        right.text(j, i, f"{value:.2f}", ha="center", va="center", color=ink)
    right.set_xlabel("component")
    figure.colorbar(image, ax=right, label="loading")
    return figure


def impulse_figure(result: Result) -> Figure:
    """Return the impulse responses with their 99 % bands."""
    rows, period_s = result["impulse"]["rows"], result["period_s"]
    figure, grid = panels(len(rows), min(3, len(rows)), height=2.1)
    for axes, row in zip(grid, rows, strict=True):
        t_s = np.arange(len(row["response"])) * period_s
        band = _array(row["band"])
        axes.fill_between(t_s, -band, band, color="0.85", step="mid")
        axes.plot(t_s, row["response"], marker=".", markersize=3, linewidth=0.8)
        if row["delay"] is not None:
            axes.axvline(row["delay"] * period_s, color="C3", linestyle="--", linewidth=0.8)
        axes.set_title(row["input"])
    figure.supxlabel("s after a pulse of one sample")
    figure.supylabel(f"{result['output']} per unit of input")
    return figure


def correlation_figure(result: Result) -> Figure:
    """Draw R of training, validation and test and the MSE of every model, as the paper does."""
    models = [m for m in result["models"] if m["same_as"] is None]
    figure = Figure(figsize=(9, 7.5), layout="constrained")
    axes: list[Axes] = list(figure.subplots(3, 1, sharex=True))
    for axis, (mode, (title, shift, colour)) in zip(axes, MODES.items(), strict=False):
        _draw_correlations(axis, models, mode)
        axis.set_title(title)
        values = np.array([np.median(errors(m, mode, "test") ** 2) for m in models])
        values[~np.isfinite(values)] = np.nan
        axes[2].bar(np.arange(len(models)) + shift, values, 0.4, color=colour, label=title)
    axes[0].legend(ncols=3, loc="lower left")
    axes[2].set(yscale="log", ylabel="MSE of the test blocks, scaled", title="mean squared error")
    axes[2].legend(ncols=2)
    axes[2].grid(axis="y", alpha=0.3)
    axes[2].set_xticks(range(len(models)), [_tick(m) for m in models], rotation=90)
    return figure


def _draw_correlations(axis: Axes, models: Sequence[Result], mode: str) -> None:
    """Draw R on an axis that is logarithmic in 1 - R, since good models differ only there."""
    smallest = 1.0
    for role, (shift, mark, colour) in LOOKS.items():
        below = [1 - np.nan_to_num(correlations(m, mode, role)) for m in models]
        below = [np.clip(v, 1e-6, 1 - R_FLOOR) for v in below]
        middle, low, high = (np.array([f(v) for v in below]) for f in (np.median, np.min, np.max))
        look: dict[str, Any] = {"fmt": mark, "ms": 4, "lw": 1, "color": colour}
        at = np.arange(len(models)) + shift
        axis.errorbar(at, middle, (middle - low, high - middle), label=ROLES[role], **look)
        smallest = min(smallest, float(low.min()))
    axis.set(yscale="log", ylim=(1.1 * (1 - R_FLOOR), 0.7 * smallest), ylabel="R")
    ticks = [t for t in R_TICKS if 1 - t > 0.7 * smallest]
    axis.set_yticks([1 - t for t in ticks], [f"{t:g}" for t in ticks])
    axis.minorticks_off()
    axis.grid(axis="y", alpha=0.3)


def _tick(model: Result) -> str:
    algorithm = "BR" if model["algorithm"] == BAYES else model["algorithm"]
    rate = f" {model['rate']:g}" if algorithm == DESCENT and model["rate"] is not None else ""
    layers = "-".join(map(str, model["hidden"]))
    return f"{model['number']}  {algorithm} {model['lags']} {layers}{rate}"


def sensor_figure(views: Sequence[Result], sensor: Result) -> Figure:
    """Draw an excerpt and a scatter of each view, as figure 6 of the paper."""
    figure, grid = panels(2 * len(views), 2, height=2.3, width_ratios=[3.4, 1])
    for left, right, view in zip(grid[::2], grid[1::2], views, strict=True):
        _excerpt(left, view, sensor)
        left.set_title(f"{view['title']} ({view['source']})", loc="left")
        left.yaxis.label.set_fontsize(9 if len(label(sensor)) < 20 else 7)
        _scatter(right, view)
    legend(grid[0])
    grid[-2].set_xlabel("s of the excerpt")
    grid[-1].set_xlabel("measured")
    return figure


def label(result: Result) -> str:
    """Return the output's name and unit for an axis."""
    return with_unit(result["output"], result["unit"])


def _array(values: Sequence[float | None]) -> FloatArray:
    return np.array(values, dtype=np.float64)  # NaN where JSON has null


def _excerpt(axes: Axes, view: Result, result: Result) -> None:
    """Draw sensor and model over time, samples that are not judged on grey."""
    judged = np.array(view["judged"], dtype=bool)
    t_s = np.arange(len(judged)) * result["period_s"]
    series = [_array(view["excerpt"][key]) for key in ("measured", "predicted")]
    for values, name, colour in zip(
        series, ("sensor", "model, free run"), (MEASURED, "C1"), strict=True
    ):
        axes.plot(t_s, values, color=colour, linewidth=0.9, label=name)
    if not judged.all():
        whole: Any = {"transform": axes.get_xaxis_transform(), "color": "0.92", "linewidth": 0}
        axes.fill_between(t_s, 0, 1, where=~judged, **whole)
    inside = np.concatenate([values[judged | ~judged.any()] for values in series])
    inside = inside[np.isfinite(inside)]
    if len(inside):
        low, high = np.quantile(inside, [0.01, 0.99])
        margin = 0.35 * max(high - low, 1e-9)
        axes.set_ylim(low - margin, high + margin)
    axes.set_ylabel(label(result))
    axes.margins(x=0)


def _scatter(axes: Axes, view: Result) -> None:
    x, y = (_array(view["scatter"][k]) for k in ("measured", "predicted"))
    axes.plot(x, y, ".", markersize=2, alpha=0.4, color="C0")
    if len(x):
        low, high = np.quantile(np.concatenate([x, y]), [0.005, 0.995])
        margin = 0.1 * max(high - low, 1e-9)
        ends = (low - margin, high + margin)
        axes.plot(ends, ends, color=LIMIT, linewidth=0.8)
        axes.set(xlim=ends, ylim=ends)
    r = view["enabled"].get("correlation")
    axes.set_title("" if r is None else f"R = {r:.3f}")
    axes.set_ylabel("predicted")


def residual_figure(sensor: Result) -> Figure:
    """Draw the residual's distribution under each fault over the healthy one, as figure 7."""
    faults, edges = sensor["faults"], np.array(sensor["edges"])
    figure, grid = panels(
        len(faults), min(3, len(faults)), height=2.4, extra=0.2, sharex=True, sharey=True
    )
    for axes, fault in zip(grid, faults, strict=True):
        axes.stairs(sensor["healthy"]["share"], edges, fill=True, color="0.8", label="healthy")
        axes.stairs(fault["share"], edges, color="C3", linewidth=1.1, label="faulty")
        axes.set_yscale("log")
        axes.set_title(words(fault["name"]))
        if (limit := sensor["limits"].get("j_mu")) is not None:
            for sign in (-1, 1):
                axes.axvline(sign * limit, **PAPER_RULE)
    grid[0].legend()
    figure.supxlabel(f"measured − predicted {label(sensor)}")
    figure.supylabel("share of samples")
    return figure
