"""The findings of ``o2train check`` as text and as an HTML page."""

from typing import Any

import numpy as np

from monitor.base.counts import counted, duration, plain
from training.pages.heat import Heat, over_plane
from training.pages.numbers import words
from training.pages.page import page, part


def as_text(result: dict[str, Any]) -> str:
    """Return the findings as lines, the verdict last."""
    lines = [_headline(result), ""]
    findings = result["findings"]
    width = max((len(f["topic"]) for f in findings), default=0)
    lines += [f"{f['level']:8} {f['topic']:{width}}  {f['text']}" for f in findings]
    if result["excitation"]:
        lines += ["", f"{'input':28} {'std':>10} {'moving':>8} {'changes':>8}"]
        lines += [
            f"{e['input']:28} {plain(e['std']):>10} {100 * e['moving']:>6.1f} % {e['moves']:>8}"
            for e in result["excitation"]
        ]
    return "\n".join([*lines, "", verdict(result)])


def verdict(result: dict[str, Any]) -> str:
    """Return one sentence: usable or not, and how many warnings and errors."""
    levels = [f["level"] for f in result["findings"]]
    errors, warnings = levels.count("error"), levels.count("warning")
    if errors:
        return f"not usable: {counted(errors, 'error')}, {counted(warnings, 'warning')}"
    return f"usable: {counted(warnings, 'warning')}"


def as_page(result: dict[str, Any]) -> str:
    """Return a self-contained HTML page."""
    kind = "good" if result["usable"] else "bad"
    return page(
        "check.html",
        "Is the data enough?",
        verdict=f"The data is {verdict(result)}.{_reason(result)}",
        confidence=_confidence(result),
        kind=kind,
        **_view(result),
    )


def section(result: dict[str, Any]) -> str:
    """Return the findings as a section of another page."""
    return part("data_check.html", verdict=verdict(result), **_view(result))


def _reason(result: dict[str, Any]) -> str:
    """Return the topics that stand against the recordings, the errors first."""
    topics = [f["topic"] for f in _worst_first(result) if f["level"] != "ok"]
    return f" Against it: {', '.join(dict.fromkeys(topics))}." if topics else ""


def _confidence(result: dict[str, Any]) -> str:
    """Return on how much the verdict rests; whether a model will be good, only a fit says."""
    seconds = sum(r["duration_s"] for r in result["recordings"])
    return (
        f"{counted(len(result['findings']), 'check')} of {seconds / 60.0:.0f} minutes of driving; "
        "they find recordings that cannot do. Only a fit shows that a model is good."
    )


def _worst_first(result: dict[str, Any]) -> list[dict[str, Any]]:
    return sorted(result["findings"], key=lambda f: ("error", "warning", "ok").index(f["level"]))


def _view(result: dict[str, Any]) -> dict[str, Any]:
    coverage = result["coverage"]
    return {
        "headline": _headline(result),
        "findings": _worst_first(result),
        "excitation": result["excitation"],
        "coverage": _coverage(coverage) if coverage else None,
    }


def _headline(result: dict[str, Any]) -> str:
    recordings = result["recordings"]
    if not recordings:
        return "no recording"
    periods = sorted({r["period_s"] for r in recordings})
    seconds = sum(r["duration_s"] for r in recordings)
    simulated = sum(r["source"] == "simulated" for r in recordings)
    text = (
        f"{counted(len(recordings), 'recording')}, {sum(r['samples'] for r in recordings)} samples "
        f"of {', '.join(f'{p:g}' for p in periods)} s, {duration(seconds)}"
    )
    return f"{text}, {simulated} simulated" if simulated else text


def _coverage(coverage: dict[str, Any]) -> Heat:
    seconds = np.array(coverage["seconds"]).T
    seconds = np.where(seconds > 0.0, seconds, np.nan)
    corner = f"{words(coverage['load'])} over {words(coverage['speed'])}, lower ends; s"
    speed, load = (np.array(coverage[key]) for key in ("speed_edges", "load_edges"))
    return over_plane(corner, speed, load, seconds, ".0f", seconds)
