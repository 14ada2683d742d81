"""A self-contained HTML page about the recordings that ``o2mon replay`` judged.

Template, style and script in ``static/`` are embedded; the page loads nothing. The same input
gives the same bytes.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monitor.base.files.outputs import write_text
from monitor.base.files.page_parts import drawing, embedded, policy_hash, static
from monitor.base.types import FloatArray
from monitor.pipeline.collector import Trace
from monitor.report.body import body
from monitor.report.vehicle_offset import vehicle_offset
from monitor.report.words import has_model

MAX_SAMPLES = 50_000  # longer recordings are thinned out; extremes are kept
_BUCKETS = 10_000  # of a thinned recording; at most five samples of each are kept
_DIGITS = 5  # significant digits of embedded values


def write_report(
    path: str | Path,
    result: Mapping[str, Any],
    traces: Sequence[Trace],
    *,
    model_info: Mapping[str, str],
    output: str = "lambda",
    steps: Mapping[str, str] | None = None,
) -> None:
    """Write the page for a result of ``o2mon.replay/1``.

    traces : one per recording of the result; an empty trace gives no plots
    model_info : facts of the model card to show, in this order
    output : quantity that the model predicts; lambda is plotted from 0.7 to 1.3 at most
    steps : commands that led to the result, with their output
    Raises ValueError if the numbers of traces and recordings differ, OSError as ``open``.
    """
    recordings = [
        {"period_s": _period_s(trace.t_s)} | recording
        for recording, trace in zip(result["recordings"], traces, strict=True)
    ]
    plotted = [
        {"output": output, **series(recording, trace)}
        for recording, trace in zip(recordings, traces, strict=True)
    ]
    style = static("uplot/uPlot.min.css", "draw.css", "report.css")
    script = drawing(static("report.js"))
    page = Template(static("report.html")).substitute(
        script_hash=policy_hash(script),
        style_hash=policy_hash(style),
        style=style,
        script=script,
        body=body(recordings, model_info, output, steps or {}),
        data="\n".join(
            f'<script type="application/json" id="series-{i}">{embedded(item)}</script>'
            for i, item in enumerate(plotted)
        ),
    )
    write_text(path, page)


def series(recording: Mapping[str, Any], trace: Trace) -> dict[str, Any]:
    """Return the data of one recording's plots, ready for JSON.

    Spans are [begin, end) in s. ``t_s`` is an object with start, period and count if the samples
    are uniform, otherwise a list.
    """
    keep = thinned(trace)
    t_s = trace.t_s[keep]
    return {
        "t_s": _grid(t_s),
        "measured": list(map(_rounded, trace.measured[keep].tolist())),
        "predicted": list(map(_rounded, trace.predicted[keep].tolist())),
        "enabled": _spans(trace.t_s, trace.enabled),
        "fault_flag": _spans(trace.t_s, trace.fault_flag),
        "samples": len(trace.t_s),
        "shown": len(t_s),
        "windows": recording["windows"],
        "limits": recording.get("limits", {}),
        "dtcs": recording["dtcs"],
        "has_model": has_model(recording),
        "vehicle_offset": vehicle_offset(recording, trace),
    }


def thinned(trace: Trace) -> NDArray[np.intp]:
    """Return the samples to plot: all, or the extremes and gaps of each bucket."""
    n = len(trace.t_s)
    if n <= MAX_SAMPLES:
        return np.arange(n)
    edges = np.linspace(0, n, _BUCKETS + 1).astype(np.intp)
    size = int(np.diff(edges).max())
    rows = np.minimum(edges[:-1, None] + np.arange(size), edges[1:, None] - 1)
    kept = []
    for values in (trace.measured, trace.predicted):
        bucket = values[rows]
        for fill, extreme in ((np.inf, np.argmin), (-np.inf, np.argmax)):
            kept.append(extreme(np.where(np.isnan(bucket), fill, bucket), axis=1))
    gap = np.isnan(trace.measured[rows])
    kept.append(np.where(gap.any(axis=1), np.argmax(gap, axis=1), kept[0]))
    return np.unique(edges[:-1] + np.stack(kept))


def _period_s(t_s: FloatArray) -> float | None:
    return float(np.median(np.diff(t_s))) if len(t_s) > 1 else None


def _grid(t_s: FloatArray) -> dict[str, float | int] | list[float]:
    n = len(t_s)
    if n > 2:
        period_s = float(t_s[-1] - t_s[0]) / (n - 1)
        if np.abs(t_s - (t_s[0] + period_s * np.arange(n))).max() < 1e-4:
            return {"start": round(float(t_s[0]), 6), "period": round(period_s, 9), "count": n}
    return [round(value, 4) for value in t_s.tolist()]


def _spans(t_s: FloatArray, on: NDArray[np.bool_]) -> list[list[float]]:
    """Return the spans in which ``on`` is true, as [begin, end) in s."""
    if not len(on):
        return []
    step = np.diff(np.concatenate(([False], on, [False])).astype(np.int8))
    ends_s = np.append(t_s, t_s[-1] + (_period_s(t_s) or 0.0))
    pairs = zip(np.flatnonzero(step == 1), np.flatnonzero(step == -1), strict=True)
    return [[round(float(t_s[a]), 4), round(float(ends_s[b]), 4)] for a, b in pairs]


def _rounded(value: float) -> float | None:
    return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None
