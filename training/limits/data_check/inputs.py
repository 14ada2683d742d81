"""Findings on the inputs: coverage, motion, copies of the output."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from monitor.base.counts import plain
from monitor.model.step import to_model_units
from training.limits.data_check import measures
from training.limits.data_check.samples import DataFinding, Usable
from training.recordings.recording import Recording
from training.recordings.samples.linear_data import output_transform

MOVES = 20  # least changes of an input; with fewer, few places show its effect
COVERED = 0.5  # least share of visited speed × load cells; a regulatory cycle visits 0.7 and more
FULLEST = 0.5  # largest share of samples in one cell; above it most samples are one operating point
COPY_LAGS = 20  # largest shift between an input and the output that the search for copies tries
SPEED = ("engine_speed_rpm", "speed_z", "rpm", "engine_speed", "speed")
LOAD = ("manifold_pressure_kpa", "air_mass_mg", "load_z", "map_kpa", "load", "engine_torque_nm")


def covered(recordings: Sequence[Recording], figures: dict[str, Any]) -> list[DataFinding]:
    """Return the finding on the coverage of speed and load; store its histogram in ``figures``."""
    names = [
        next((n for n in choice if all(n in r.names for r in recordings)), None)
        for choice in (SPEED, LOAD)
    ]
    if names[0] is None or names[1] is None:
        text = "no columns of engine speed and load in all recordings: coverage is not judged"
        return [DataFinding("ok", "coverage", text)]
    pairs = [np.column_stack([r.column(str(n)) for n in names]) for r in recordings]
    both = np.concatenate(pairs)
    both = both[np.isfinite(both).all(axis=1)]
    if not len(both):
        text = f"{names[0]} and {names[1]} are never valid together"
        return [DataFinding("warning", "coverage", text)]
    cover = measures.coverage(both[:, 0], both[:, 1], recordings[0].period_ns / 1e9)
    measured = {key: np.asarray(value).tolist() for key, value in asdict(cover).items()}
    figures["coverage"] = {"speed": names[0], "load": names[1], **measured}
    text = (
        f"{100 * cover.share:.0f} % of the {measures.CELLS}×{measures.CELLS} cells between "
        f"{plain(cover.speed_edges[0])} and {plain(cover.speed_edges[-1])} {names[0]} and "
        f"{plain(cover.load_edges[0])} and {plain(cover.load_edges[-1])} {names[1]} visited, "
        f"{100 * cover.fullest:.0f} % of the time in the fullest"
    )
    if cover.share < COVERED or cover.fullest > FULLEST:
        text += (
            f"; {100 * COVERED:g} % of the cells and no cell above {100 * FULLEST:g} % are wanted"
        )
        return [DataFinding("warning", "coverage", text)]
    return [DataFinding("ok", "coverage", text)]


def excited(
    recordings: Sequence[Recording], data: Usable, inputs: Sequence[str], figures: dict[str, Any]
) -> list[DataFinding]:
    """Return the findings on how the inputs move; store the measures in ``figures``."""
    findings = []
    for i, name in enumerate(inputs):
        motion = measures.motion([u[:, i] for u in data.u])
        figures["excitation"].append({"input": name, **asdict(motion)})
        if motion.moves == 0:
            values = np.concatenate([r.column(name) for r in recordings])
            if np.ptp(values[np.isfinite(values)]) > 0.0:  # else ``usable`` has reported it
                text = f"{name} is constant where all inputs are valid: leave it out"
                findings.append(DataFinding("error", "constant", text))
        elif motion.moves < MOVES:
            text = (
                f"{name} changes {motion.moves} times, {MOVES} times are wanted: its effect is "
                "seen in a few places only"
            )
            findings.append(DataFinding("warning", "excitation", text))
    return findings or [DataFinding("ok", "excitation", "every input moves")]


def copies(data: Usable, inputs: Sequence[str], output: str) -> list[DataFinding]:
    """Return the findings on inputs that are a shifted or scaled copy of the output."""
    findings = []
    transform = output_transform(output)
    rows = [np.isfinite(y) for y in data.y]
    forms = [[y[r] for y, r in zip(data.y, rows, strict=True)]]
    if transform != "none":
        forms.append([to_model_units(transform, y) for y in forms[0]])
    for i, name in enumerate(inputs):
        values = [u[r, i] for u, r in zip(data.u, rows, strict=True)]
        level, change, lag = max(
            (measures.copy_of(values, form, COPY_LAGS) for form in forms), key=lambda c: abs(c[0])
        )
        if abs(level) <= measures.COPY:
            continue
        shift = f" shifted by {lag} samples" if lag else ""
        text = f"{name} follows {output}{shift} with a correlation of {level:.5f}"
        if abs(change) > measures.COPY:
            text += ": a copy of the output is no input, leave it out"
            findings.append(DataFinding("error", "leak", text))
        else:
            text += f", changes with {change:.3f}: make sure that it is not made from the output"
            findings.append(DataFinding("warning", "leak", text))
    if not findings:
        text = f"no input is a scaled or shifted copy of {output} (within {COPY_LAGS} samples)"
        findings.append(DataFinding("ok", "leak", text))
    return findings
