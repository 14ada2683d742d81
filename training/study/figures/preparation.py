"""Figures of the preparation: spectra with their lines."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from training.pages.figure import LIMIT, panels

Result = Mapping[str, Any]

LINES = {"noise": "C3", "commanded": "C2", "driven": "C8"}


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


def inputs_figure(result: Result) -> Figure:
    """Draw the inputs' spectra, each divided by its variance, with their lines."""
    spectrum, names = result["spectrum"], result["inputs"]
    f = np.array(spectrum["frequency_hz"])[1:-1]
    figure, grid = panels(len(names), min(3, len(names)), height=1.7, extra=0.4, sharex=True)
    for axes, name in zip(grid, names, strict=True):
        density = np.array(spectrum["density"][name])
        variance = max(float(density.sum() * spectrum["frequency_hz"][1]), 1e-300)
        axes.semilogy(f, np.maximum(density[1:-1] / variance, 1e-12), lw=0.8, color="C0")
        for line in (x for x in result["lines"] if x["signal"] == name):
            axes.axvspan(line["low_hz"], line["high_hz"], color="0.5", alpha=0.35)
        axes.set_title(name)
    figure.supxlabel("frequency, Hz")
    figure.supylabel("share of the variance, 1/Hz")
    return figure
