"""Part 1 of the study as HTML: outliers, spectrum, noise lines, linear preparation."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from training.pages.page import paragraph, picture, table

COLOURS = {"missing": "#888888", "out_of_range": "#c0392b", "spike": "#e67e22"}
WORDS = {"missing": "missing", "out_of_range": "out of range", "spike": "spike"}
UNCERTAIN_DB = 3.0


def section(result: dict[str, Any]) -> str:
    """Return the part's HTML from what ``preparation`` gave."""
    parts = ["<h2>Preparation</h2>", _overview(result), "<h3>Outliers and gaps</h3>"]
    parts.append(_outlier_table(result))
    if result["marks"]:
        caption = "Where samples cannot be used, drives end to end"
        parts.append(picture(_outlier_figure(result), caption))
    parts += ["<h3>Fourier analysis</h3>", *_spectral(result)]
    parts += ["<h3>What the linear baselines are given</h3>", *_linear(result)]
    return "\n".join(parts)


def _overview(result: dict[str, Any]) -> str:
    rows = [
        (r["path"], r["source"] or "not said", str(r["samples"]), f"{r['duration_s']:.0f}")
        for r in result["recordings"]
    ]
    text = f"{len(rows)} recordings on a grid of {result['period_s']:g} s."
    return paragraph(text) + table(rows, ("recording", "source", "samples", "s"))


def _outlier_table(result: dict[str, Any]) -> str:
    rows = [
        (
            f"{o['signal']} [{o['unit']}]" if o["unit"] else o["signal"],
            str(o["out_of_range"]),
            str(o["spike"]),
            str(o["missing"]),
            f"{100 * o['missing'] / max(o['samples'], 1):.2f}",
            f"{o['longest_gap_s']:g}",
        )
        for o in result["outliers"]
    ]
    head = ("signal", "out of range", "spikes", "missing", "missing, %", "longest gap, s")
    note = "A spike is a lone sample more than twelve robust deviations off both neighbours. "
    note += "Outliers are masked for every model."
    return table(rows, head) + paragraph(note, "note")


def _outlier_figure(result: dict[str, Any]) -> Figure:
    names = [o["signal"] for o in result["outliers"]]
    figure = Figure(figsize=(10, 0.8 + 0.3 * len(names)), layout="constrained")
    axes = figure.subplots()
    ends_s = np.cumsum([r["duration_s"] for r in result["recordings"]])
    for end_s in ends_s[:-1]:
        axes.axvline(end_s, color="#dddddd", lw=0.8)
    for reason, colour in COLOURS.items():
        marks = [m for m in result["marks"] if m["reason"] == reason]
        for number, mark in enumerate(marks):
            at = names.index(mark["signal"])
            wide = max(mark["stop_s"] - mark["start_s"], 0.002 * float(ends_s[-1]))
            label = WORDS[reason] if number == 0 else None
            axes.broken_barh([(mark["start_s"], wide)], (at - 0.35, 0.7), color=colour, label=label)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlim(0.0, float(ends_s[-1]))
    axes.set_xlabel("time, s; grey lines part the drives")
    figure.legend(loc="outside upper right", ncols=3, frameon=False)
    return figure


def _spectral(result: dict[str, Any]) -> list[str]:
    spectrum = result["spectrum"]
    if spectrum is None:
        return [paragraph("The unbroken stretches are too short for a spectrum.", "warning")]
    which = "in closed loop outside fuel cut" if spectrum["rows"] == "enabled" else "of all samples"
    output = f"phi = 1/{result['output']}" if result["transform"] == "phi" else result["output"]
    text = (
        f"Welch's method, Hann window, {spectrum['averages']:.0f} independent averages of "
        f"{1 / spectrum['resolution_hz']:.3g} s, {which}. A line is narrow and stands above the "
        "running median of the logarithmic spectrum by more than chance allows in any of the bins "
        f"(chi-square, one false line in a thousand spectra), and by {UNCERTAIN_DB:g} dB at least."
    )
    parts = [paragraph(text), picture(_figure(result), f"Spectrum of {output} with its lines")]
    if result["inputs"]:
        caption = "Spectra of the inputs, each divided by its variance, with their lines"
        parts.append(picture(_inputs_figure(result), caption))
    parts.append(_line_table(result))
    said: dict[str, list[str]] = {}
    for x in result["lines"]:
        if x["signal"] == result["output"]:
            said.setdefault(x["words"], []).append(f"{x['low_hz']:.2f}–{x['high_hz']:.2f} Hz")
    parts += [paragraph(f"{', '.join(b)}: {output} {words}.") for words, b in said.items()]
    if result["band_hz"] is None:
        parts.append(paragraph("No narrow noise band is found in the output; no filter is used."))
    return parts


def _figure(result: dict[str, Any]) -> Figure:
    spectrum = result["spectrum"]
    f = np.array(spectrum["frequency_hz"])[1:-1]
    figure = Figure(figsize=(10, 6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    density = np.array(spectrum["density"][result["output"]])[1:-1]
    unit = "1/Hz" if result["transform"] == "phi" else "unit²/Hz"
    upper.semilogy(f, density, lw=1.0, color="#1f4e79", label="spectrum of the output")
    upper.semilogy(f, spectrum["background"][1:-1], lw=1.0, color="#999999", label="background")
    colours = {"noise": "#e74c3c", "commanded": "#27ae60", "driven": "#f1c40f"}
    seen = set()
    for line in result["lines"]:
        if line["signal"] == result["output"]:
            label = None if line["kind"] in seen else f"line, {line['kind']}"
            seen.add(line["kind"])
            colour = colours[line["kind"]]
            upper.axvspan(line["low_hz"], line["high_hz"], color=colour, alpha=0.35, label=label)
    upper.set_ylabel(f"power spectral density, {unit}")
    upper.legend(frameon=False)
    peaks = [
        (max(values[4:-2], default=0.0), name) for name, values in spectrum["coherence"].items()
    ]
    for _, name in sorted(peaks, reverse=True)[:4]:
        lower.plot(f, spectrum["coherence"][name][1:-1], lw=1.0, label=name)
    lower.axhline(spectrum["coherence_limit"], color="#999999", lw=0.8, ls="--")
    lower.set_ylim(0.0, 1.02)
    lower.set_ylabel("coherence with the output")
    lower.set_xlabel("frequency, Hz; dashed: unrelated signals stay below in 95 %")
    lower.legend(frameon=False, ncols=2)
    return figure


def _inputs_figure(result: dict[str, Any]) -> Figure:
    spectrum, names = result["spectrum"], result["inputs"]
    f = np.array(spectrum["frequency_hz"])[1:-1]
    n_rows = -(-len(names) // 3)
    figure = Figure(figsize=(10, 0.4 + 1.7 * n_rows), layout="constrained")
    grid = figure.subplots(n_rows, min(3, len(names)), sharex=True, squeeze=False)
    for axes in grid.flat[len(names) :]:
        axes.set_axis_off()
    for axes, name in zip(grid.flat, names, strict=False):
        density = np.array(spectrum["density"][name])
        variance = max(float(density.sum() * spectrum["frequency_hz"][1]), 1e-300)
        axes.semilogy(f, np.maximum(density[1:-1] / variance, 1e-12), lw=0.8, color="#1f4e79")
        for line in result["lines"]:
            if line["signal"] == name:
                axes.axvspan(line["low_hz"], line["high_hz"], color="#888888", alpha=0.35)
        axes.set_title(name, fontsize=9)
    figure.supxlabel("frequency, Hz", fontsize=9)
    figure.supylabel("share of the variance, 1/Hz", fontsize=9)
    return figure


def _line_table(result: dict[str, Any]) -> str:
    rows = []
    for line in result["lines"]:
        strongest = sorted(line["coherence"].items(), key=lambda x: -x[1])[:2]
        rows.append(
            (
                line["signal"],
                f"{line['low_hz']:.2f}–{line['high_hz']:.2f}",
                f"{line['above_db']:.1f}",
                "<1e-12" if line["p_value"] < 1e-12 else f"{line['p_value']:.1e}",
                f"{100 * line['share_of_variance']:.3g}",
                ", ".join(f"{n} {c:.2f}" for n, c in strongest),
                line["kind"],
            )
        )
    if not rows:
        return paragraph("No signal carries a narrow line.")
    head = ("signal", "Hz", "dB", "p", "variance, %", "coherent with", "kind")
    note = "dB above the background; p by chance anywhere in the spectrum; share of the variance."
    return table(rows, head) + paragraph(note, "note")


def _linear(result: dict[str, Any]) -> list[str]:
    linear, own = result["linear"], result["filter"]
    text = (
        f"{result['linear_samples']} samples in {result['linear_stretches']} unbroken stretches. "
        "Holes of up to three samples are bridged. From every recording its own linear trend is "
        "taken, then the common mean, then each signal is divided by its standard deviation; the "
        "numbers are kept, so every step can be undone. A held-out recording gets the same mean "
        "and deviation and no trend of its own, so that nothing of it is looked at."
    )
    parts = [paragraph(text), _linear_table(linear)]
    if own is not None:
        edges = " and ".join(f"{e:.2f}" for e in own["edges_hz"])
        kind = "band-stop" if own["kind"] == "bandstop" else "low-pass"
        parts.append(
            paragraph(
                f"Filter: Butterworth {kind} of order {own['order']}, edges {edges} Hz, run forward"
                " and backward (zero phase, twice the attenuation, 6 dB at the edges), at least "
                f"{own['attenuation_db']:.0f} dB within the band, on inputs and output alike. The "
                "filter alone cannot be undone."
            )
        )
    last = "Trend removal and this filter look ahead in time: they serve the linear baselines only."
    parts.append(paragraph(f"{last} The model that ships sees neither.", "note"))
    return parts


def _linear_table(linear: dict[str, Any]) -> str:
    rows = []
    for i, name in enumerate(linear["names"]):
        last = i == len(linear["names"]) - 1 and linear["transform"] == "phi"
        slopes = [60.0 * t["slope"][i] / linear["std"][i] for t in linear["trends"].values()]
        rows.append(
            (
                f"1/{name}" if last else name,
                f"{linear['mean'][i]:.5g}",
                f"{linear['std'][i]:.5g}",
                f"{min(slopes):.3f} to {max(slopes):.3f}",
            )
        )
    return table(rows, ("signal", "mean", "standard deviation", "trend, deviations per minute"))
