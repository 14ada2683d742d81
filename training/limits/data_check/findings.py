"""The findings of ``o2train check`` as text and as an HTML page."""

from typing import Any, Final

import numpy as np

from monitor.base.counts import counted, duration, plain
from training.pages.heat import Heat, over_plane
from training.pages.numbers import words
from training.pages.page import page, part

LEVELS: Final = ("error", "warning", "ok")  # the worst first


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
    told = f"not usable: {counted(errors, 'error')}, " if errors else "usable: "
    return told + counted(warnings, "warning")


def as_page(result: dict[str, Any]) -> str:
    """Return a self-contained HTML page."""
    view, seconds = _view(result), sum(r["duration_s"] for r in result["recordings"])
    against = dict.fromkeys(f["topic"] for f in view["findings"] if f["level"] != "ok")
    reason = f" Against it: {', '.join(against)}." if against else ""
    return page(
        "check.html",
        "Is the data enough?",
        verdict=f"The data is {verdict(result)}.{reason}",
        confidence=f"{counted(len(result['findings']), 'check')} of {seconds / 60.0:.0f} minutes "
        "of driving; they find recordings that cannot do. Only a fit shows that a model is good.",
        kind="good" if result["usable"] else "bad",
        **view,
    )


def section(result: dict[str, Any]) -> str:
    """Return the findings as a section of another page."""
    return part("data_check.html", verdict=verdict(result), **_view(result))


def _view(result: dict[str, Any]) -> dict[str, Any]:
    return {
        "headline": _headline(result),
        "findings": sorted(result["findings"], key=lambda f: LEVELS.index(f["level"])),
        "excitation": result["excitation"],
        "coverage": result["coverage"] and _coverage(result["coverage"]),
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
    return over_plane(corner, coverage["speed_edges"], coverage["load_edges"], seconds)
