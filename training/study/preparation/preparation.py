"""Part 1 of the study: outliers, spectra, noise lines, and the data of the linear baselines."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.files.manifest import source_of
from monitor.base.signals import BY_NAME, plausible_range
from monitor.base.types import FloatArray, Quality
from training.recordings.linear_data import (
    Filter,
    LinearData,
    cleaned,
    linear_records,
    linear_stretches,
    output_transform,
)
from training.recordings.outliers import outlier_mask
from training.recordings.preparation import enabled_rows
from training.recordings.recording import Recording
from training.recordings.rows import runs
from training.recordings.spectrum import (
    Line,
    Spectrum,
    background,
    coherence_limit,
    find_lines,
    welch,
)

__all__ = ["Filter", "LinearData", "linear_records", "linear_stretches", "preparation"]

COMMAND, CONTROLLER = "lambda_target", "lambda_controller"
COHERENT = 0.5  # at this coherence a signal explains half of a line's power in another
MOST_MARKS = 1500  # stretches of unusable samples kept for the figure


def preparation(
    recordings: Sequence[Recording], inputs: Sequence[str], output: str
) -> dict[str, Any]:
    """Return outliers, spectra, noise lines, the filter and the linear preparation as plain values.

    Raises RecordingError if a signal is missing or no stretch of valid samples is left.
    """
    linear_stretches(recordings, inputs, output)  # raises for wrong names and periods
    band, spectral = _spectral(recordings, inputs, output)
    parts, linear = linear_stretches(recordings, inputs, output, band)
    return {
        "inputs": list(inputs),
        "output": output,
        "transform": linear.transform,
        "period_s": recordings[0].period_ns / 1e9,
        "recordings": [_recording(r) for r in recordings],
        "outliers": [_outliers(recordings, name) for name in (*inputs, output)],
        "marks": _marks(recordings, (*inputs, output)),
        **spectral,
        "band_hz": band,
        "filter": asdict(linear.filter) if linear.filter else None,
        "linear": linear.as_dict(),
        "linear_samples": sum(len(p.t_s) for p in parts),
        "linear_stretches": len(parts),
    }


def _recording(recording: Recording) -> dict[str, Any]:
    return {
        "path": Path(recording.path).name,
        "samples": len(recording.t_s),
        "duration_s": len(recording.t_s) * recording.period_ns / 1e9,
        "source": source_of(Path(recording.path), recording.sha256),
    }


def reasons(recording: Recording, name: str) -> dict[str, np.ndarray]:
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
    return {
        "out_of_range": np.asarray(outside | (bad & ~spike)),
        "spike": np.asarray(spike),
        "missing": np.asarray(np.isnan(values) & ~outside),
    }


def _outliers(recordings: Sequence[Recording], name: str) -> dict[str, Any]:
    masks = [reasons(r, name) for r in recordings]
    gaps = [
        (stop - first) * r.period_ns / 1e9
        for r, m in zip(recordings, masks, strict=True)
        for first, stop in runs(m["missing"])
    ]
    return {
        "signal": name,
        "unit": BY_NAME[name].unit if name in BY_NAME else "",
        "samples": sum(len(m["missing"]) for m in masks),
        **{reason: int(sum(m[reason].sum() for m in masks)) for reason in masks[0]},
        "gaps": len(gaps),
        "longest_gap_s": round(max(gaps, default=0.0), 9),
    }


def _marks(recordings: Sequence[Recording], names: Sequence[str]) -> list[dict[str, Any]]:
    """Return the longest stretches of unusable samples: signal, reason, start and stop.

    Times are in seconds, with the drives placed end to end.
    """
    found: list[dict[str, Any]] = []
    begin_s = 0.0
    for recording in recordings:
        period_s = recording.period_ns / 1e9
        for name in names:
            for reason, mask in reasons(recording, name).items():
                found += [
                    {
                        "signal": name,
                        "reason": reason,
                        "start_s": round(begin_s + a * period_s, 3),
                        "stop_s": round(begin_s + b * period_s, 3),
                    }
                    for a, b in runs(mask)
                ]
        begin_s += len(recording.t_s) * period_s
    longest = sorted(found, key=lambda m: m["start_s"] - m["stop_s"])
    return longest[:MOST_MARKS]


def _spectral(
    recordings: Sequence[Recording], inputs: Sequence[str], output: str
) -> tuple[list[float] | None, dict[str, Any]]:
    """Return the noise band [low, high] in Hz (None without one), and the spectra with lines."""
    also = [
        n
        for n in (COMMAND, CONTROLLER)
        if n not in inputs and all(n in r.names for r in recordings)
    ]
    names = [*inputs, *also, output]
    found, rows = None, "enabled"
    for rows in ("enabled", "all"):
        found = welch(_stretches(recordings, names, rows), recordings[0].period_ns / 1e9)
        if found is not None:
            break
    if found is None:
        return None, {"spectrum": None, "lines": []}
    if not any(name in r.names for r in recordings for name in ("closed_loop", "fuel_cut")):
        rows = "all"
    lines: list[dict[str, Any]] = []
    for column, name in enumerate(names):
        own = find_lines(found.frequency_hz, found.density[:, column], found.averages)
        lines += [{"signal": name, **_line(line, found, names, column)} for line in own]
    noise = [x for x in lines if x["signal"] == output and x["kind"] == "noise"]
    strongest = max(noise, key=lambda x: x["above_db"], default=None)
    band = [strongest["low_hz"], strongest["high_hz"]] if strongest else None
    return band, {"spectrum": _spectrum(found, names, rows), "lines": lines}


def _stretches(
    recordings: Sequence[Recording], names: Sequence[str], rows: str
) -> list[FloatArray]:
    result = []
    for recording in recordings:
        values = cleaned(recording, names, output_transform(names[-1]))
        good = np.asarray(np.isfinite(values).all(axis=1))
        if rows == "enabled":
            good &= enabled_rows(recording)
        result += [values[a:b] for a, b in runs(good)]
    return result


def _line(line: Line, found: Spectrum, names: Sequence[str], column: int) -> dict[str, Any]:
    """Return a line as plain values, with its coherence to other signals and its kind."""
    at = int(np.argmin(np.abs(found.frequency_hz - line.peak_hz)))
    coherence = {n: float(c) for n, c in zip(names, found.coherence[at], strict=True)}
    others = {n: round(c, 3) for n, c in coherence.items() if n != names[-1]}
    variance = float(found.density[:, column].sum() * found.frequency_hz[1])
    kind, words = _origin(others) if column == len(names) - 1 else ("", "")
    return {
        "low_hz": round(line.low_hz, 4),
        "high_hz": round(line.high_hz, 4),
        "peak_hz": round(line.peak_hz, 4),
        "above_db": round(line.above_db, 2),
        "p_value": line.p_value,
        "share_of_variance": max(line.power, 0.0) / variance if variance > 0 else 0.0,
        "coherence": others if kind else {names[-1]: round(coherence[names[column]], 3)},
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
    if carriers - {CONTROLLER}:
        listed = ", ".join(sorted(carriers - {CONTROLLER}))
        return "driven", f"is carried by {listed}: a response to the inputs, not filtered"
    if CONTROLLER in carriers:
        known = (
            "the commanded mixture does not carry it"
            if COMMAND in coherence
            else ("no other input carries it")
        )
        return "noise", (
            f"is a disturbance: {known}, and the lambda controller answers what is measured, so "
            "it carries the line, too"
        )
    return "noise", "is a disturbance: no input carries it (coherence below 0.5 with each)"


def _spectrum(found: Spectrum, names: Sequence[str], rows: str) -> dict[str, Any]:
    return {
        "rows": rows,
        "averages": round(found.averages, 1),
        "resolution_hz": float(found.frequency_hz[1]),
        "coherence_limit": coherence_limit(found.averages),
        "frequency_hz": _short(found.frequency_hz),
        "density": {n: _short(found.density[:, i]) for i, n in enumerate(names)},
        "background": _short(background(found.density[:, -1])),
        "coherence": {n: _short(found.coherence[:, i]) for i, n in enumerate(names[:-1])},
    }


def _short(values: FloatArray) -> list[float]:
    """Return the values rounded to five significant digits."""
    return [float(f"{v:.5g}") for v in values]
