"""Preparation: outliers, spectra, noise lines, and the data of the linear baselines."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from monitor.base.runs import runs
from monitor.base.signals import BY_NAME, plausible_range
from monitor.base.types import Quality
from training.jobs.json_tree import json_tree
from training.recordings.recording import Recording
from training.recordings.samples.linear_data import cleaned, linear_stretches
from training.recordings.samples.outliers import outlier_mask
from training.recordings.samples.preparation import enabled_rows, output_transform
from training.recordings.spectrum import (
    SpectralLine,
    Spectrum,
    background,
    coherence_limit,
    find_lines,
    welch,
)

COMMAND, CONTROLLER = "lambda_target", "lambda_controller"
COHERENT = 0.5  # at this coherence a signal explains half of a line's power in another
UNCOMMANDED = "the commanded mixture does not carry it"
NO_OTHER = "no other input carries it"


def preparation(
    recordings: Sequence[Recording], inputs: Sequence[str], output: str
) -> dict[str, Any]:
    """Return outliers, spectra, noise lines, the filter and the linear preparation as plain values.

    Raises RecordingError if a signal is missing or no stretch of valid samples is left.
    """
    linear_stretches(recordings, inputs, output)  # raises for wrong names and periods
    names, period_s = (*inputs, output), recordings[0].period_ns / 1e9
    spectrum, lines = _spectral(recordings, inputs, output)
    noise = [x for x in lines if x["signal"] == output and x["kind"] == "noise"]
    strongest = max(noise, key=lambda x: x["above_db"], default=None)
    band = [strongest["low_hz"], strongest["high_hz"]] if strongest else None
    parts, linear = linear_stretches(recordings, inputs, output, band)
    reasons = [{name: unusable(r, name) for name in names} for r in recordings]
    return {
        "inputs": list(inputs),
        "output": output,
        "transform": linear.transform,
        "period_s": period_s,
        "recordings": len(recordings),
        "outliers": [_outliers(name, [m[name] for m in reasons], period_s) for name in names],
        "spectrum": spectrum,
        "lines": lines,
        "band_hz": band,
        "filter": asdict(linear.filter) if linear.filter else None,
        "linear": linear.as_dict(),
        "linear_samples": sum(len(p.t_s) for p in parts),
        "linear_stretches": len(parts),
    }


Masks = dict[str, np.ndarray]  # by reason


def unusable(recording: Recording, name: str) -> Masks:
    """Return masks (n,) bool of the unusable samples of ``name``, by reason.

    out_of_range : outside the signal's plausible range, here or by the file's reader
    spike : a single sample far from its neighbours
    missing : never received, too old, blank, or marked as not available
    """
    values = recording.column(name)
    quality = recording.quality[:, list(recording.names).index(name)]
    low, high = plausible_range(name)
    with np.errstate(invalid="ignore"):
        outside = (quality == Quality.OUT_OF_RANGE) | (values < low) | np.isinf(values)
        bad = outlier_mask(name, values)
        # an outlier inside the range is a spike; lean air above the range is neither
        spike = bad & ~outside & ~(values > high)
    missing = np.isnan(values) & ~outside
    return {"out_of_range": outside | (bad & ~spike), "spike": spike, "missing": missing}


def _outliers(name: str, masks: Sequence[Masks], period_s: float) -> dict[str, Any]:
    gaps = [(b - a) * period_s for m in masks for a, b in runs(m["missing"])]
    return {
        "signal": name,
        "unit": BY_NAME[name].unit if name in BY_NAME else "",
        "samples": sum(len(m["missing"]) for m in masks),
        **{reason: int(sum(m[reason].sum() for m in masks)) for reason in masks[0]},
        "gaps": len(gaps),
        "longest_gap_s": round(max(gaps, default=0.0), 9),
    }


def _spectral(
    recordings: Sequence[Recording], inputs: Sequence[str], output: str
) -> tuple[dict[str, Any] | None, list[dict[str, Any]]]:
    """Return the spectra, None if all stretches are too short, and the lines in them."""
    common = set[str].intersection(*({*r.names} for r in recordings)) - {*inputs}
    also = [n for n in (COMMAND, CONTROLLER) if n in common]
    names = [*inputs, *also, output]
    values = [cleaned(r, names, output_transform(output)) for r in recordings]
    good = [np.asarray(np.isfinite(v).all(axis=1)) for v in values]
    judged = [g & enabled_rows(r) for g, r in zip(good, recordings, strict=True)]

    def welch_of(masks: Sequence[np.ndarray]) -> Spectrum | None:
        parts = [v[a:b] for v, mask in zip(values, masks, strict=True) for a, b in runs(mask)]
        return welch(parts, recordings[0].period_ns / 1e9)

    on = welch_of(judged)
    found = on or welch_of(good)
    if found is None:
        return None, []
    known = any(name in r.names for r in recordings for name in ("closed_loop", "fuel_cut"))
    lines = [
        {"signal": name, **_line(line, found, names, column)}
        for column, name in enumerate(names)
        for line in find_lines(found.frequency_hz, found.density[:, column], found.averages)
    ]
    spectrum = {
        "rows": "enabled" if on and known else "all",
        "averages": round(found.averages, 1),
        "resolution_hz": float(found.frequency_hz[1]),
        "coherence_limit": coherence_limit(found.averages),
        "frequency_hz": json_tree(found.frequency_hz),
        "density": {n: json_tree(found.density[:, i]) for i, n in enumerate(names)},
        "background": json_tree(background(found.density[:, -1])),
        "coherence": {n: json_tree(found.coherence[:, i]) for i, n in enumerate(names[:-1])},
    }
    return spectrum, lines


def _line(line: SpectralLine, found: Spectrum, names: Sequence[str], column: int) -> dict[str, Any]:
    """Return a line as plain values, with its coherence to other signals and its kind."""
    at = int(np.argmin(np.abs(found.frequency_hz - line.peak_hz)))
    coherence = {n: round(float(c), 3) for n, c in zip(names, found.coherence[at], strict=True)}
    others = {n: c for n, c in coherence.items() if n != names[-1]}
    variance = float(found.density[:, column].sum() * found.frequency_hz[1])
    kind, words = _origin(others) if column == len(names) - 1 else ("", "")
    return {
        "low_hz": round(line.low_hz, 4),
        "high_hz": round(line.high_hz, 4),
        "peak_hz": round(line.peak_hz, 4),
        "above_db": round(line.above_db, 2),
        "p_value": line.p_value,
        "share_of_variance": max(line.power, 0.0) / variance if variance > 0 else 0.0,
        "coherence": others if kind else {names[-1]: coherence[names[column]]},
        "kind": kind,
        "words": words,
    }


def _origin(coherence: dict[str, float]) -> tuple[str, str]:
    """Return the kind of a line of the output (commanded, driven or noise) and the reason."""
    carriers = {name for name, value in coherence.items() if value >= COHERENT}
    if COMMAND in carriers:
        return "commanded", (
            "follows the commanded mixture: the controller's own dither, which identifies the "
            "plant and is not filtered"
        )
    if driving := carriers - {CONTROLLER}:
        listed = ", ".join(sorted(driving))
        return "driven", f"is carried by {listed}: a response to the inputs, not filtered"
    if not carriers:
        return "noise", "is a disturbance: no input carries it (coherence below 0.5 with each)"
    return "noise", (
        f"is a disturbance: {UNCOMMANDED if COMMAND in coherence else NO_OTHER}, and the lambda "
        "controller answers what is measured, so it carries the line, too"
    )
