"""The findings of ``o2train check`` as text and as an HTML page."""

from html import escape
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from training.pages.page import page, paragraph, picture, table


def as_text(result: dict[str, Any]) -> str:
    """Return the findings as lines, the verdict last."""
    lines = [_headline(result), ""]
    findings = result["findings"]
    width = max((len(f["topic"]) for f in findings), default=0)
    lines += [f"{f['level']:8} {f['topic']:{width}}  {f['text']}" for f in findings]
    if result["excitation"]:
        lines += ["", f"{'input':28} {'std':>10} {'moving':>8} {'order':>6} {'95 % below':>11}"]
        lines += [
            f"{e['input']:28} {e['std']:>10.4g} {100 * e['moving']:>6.1f} % {_order(e):>6} "
            f"{_hertz(e['bandwidth_hz']):>11}"
            for e in result["excitation"]
        ]
    return "\n".join([*lines, "", verdict(result)])


def verdict(result: dict[str, Any]) -> str:
    """Return one sentence: usable or not, and how many warnings and errors."""
    levels = [f["level"] for f in result["findings"]]
    errors, warnings = levels.count("error"), levels.count("warning")
    if errors:
        return f"not usable: {_count(errors, 'error')}, {_count(warnings, 'warning')}"
    return f"usable: {_count(warnings, 'warning')}"


def as_page(result: dict[str, Any]) -> str:
    """Return a self-contained HTML page."""
    return page("Is the data enough?", body(result))


def body(result: dict[str, Any]) -> str:
    """Return the page's body, for other reports."""
    kind = "" if result["usable"] else "warning"
    parts = [paragraph(_headline(result)), paragraph(f"The data is {verdict(result)}.", kind)]
    bad = {"error": 0, "warning": 1, "ok": 2}
    ordered = sorted(result["findings"], key=lambda f: bad[f["level"]])
    rows = "".join(
        f"<tr><td{' class=warning' if f['level'] != 'ok' else ''}>{f['level']}</td>"
        f"<td>{escape(f['topic'])}</td><td>{escape(f['text'])}</td></tr>"
        for f in ordered
    )
    parts.append(f"<table><tr><th></th><th>what</th><th>finding</th></tr>{rows}</table>")
    if result["coverage"]:
        caption = "Seconds driven in each cell of speed and load; blank cells were not visited"
        parts.append(picture(_coverage_figure(result["coverage"]), caption))
    if result["excitation"]:
        parts.append(_excitation_table(result))
    return "\n".join(parts)


def _headline(result: dict[str, Any]) -> str:
    recordings = result["recordings"]
    if not recordings:
        return "no recording"
    periods = sorted({r["period_s"] for r in recordings})
    seconds = sum(r["duration_s"] for r in recordings)
    simulated = sum(r["source"] == "simulated" for r in recordings)
    text = (
        f"{_count(len(recordings), 'recording')}, {sum(r['samples'] for r in recordings)} samples "
        f"of {', '.join(f'{p:g}' for p in periods)} s, {seconds:.6g} s"
    )
    return f"{text}, {simulated} simulated" if simulated else text


def _excitation_table(result: dict[str, Any]) -> str:
    rows = [
        (
            e["input"],
            f"{e['std']:.4g}",
            f"{100 * e['moving']:.1f}",
            _order(e),
            _hertz(e["bandwidth_hz"]),
        )
        for e in result["excitation"]
    ]
    head = (
        "input",
        "standard deviation",
        "samples moving, %",
        "order of excitation",
        "95 % of variance below",
    )
    return table(rows, head)


def _coverage_figure(coverage: dict[str, Any]) -> Figure:
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.subplots()
    seconds = np.ma.masked_equal(np.array(coverage["seconds"]).T, 0.0)
    mesh = axes.pcolormesh(
        coverage["speed_edges"], coverage["load_edges"], seconds, cmap="Blues", vmin=0.0
    )
    axes.set_xlabel(coverage["speed"])
    axes.set_ylabel(coverage["load"])
    figure.colorbar(mesh, ax=axes, label="time, s")
    return figure


def _order(excitation: dict[str, Any]) -> str:
    order = int(excitation["order"])
    return f"≥ {order}" if order == excitation["order_tested"] else str(order)


def _hertz(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g} Hz"


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
