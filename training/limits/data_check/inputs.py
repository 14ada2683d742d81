"""Checks of the inputs: coverage, excitation, collinearity, copies of the output."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from monitor.base.signals import NARX_INPUTS
from monitor.base.types import FloatArray
from monitor.model.step import to_model_units
from training.limits.data_check import measures
from training.limits.data_check.samples import Finding, Usable
from training.recordings.linear_data import output_transform
from training.recordings.recording import Recording

MOVES = 20  # an input with fewer changes shows its effect in a few places only
COVERED = 0.5  # least share of visited cells of speed and load; regulatory cycles visit 0.7
FULLEST = 0.5  # most samples in one cell; more means mostly one operating point
COPY_LAGS = 20  # most samples by which a copy of the output may be shifted
SPEED = ("engine_speed_rpm", "speed_z", "rpm", "engine_speed", "speed")
LOAD = ("manifold_pressure_kpa", "air_mass_mg", "load_z", "map_kpa", "load", "engine_torque_nm")


def covered(recordings: Sequence[Recording], figures: dict[str, Any]) -> list[Finding]:
    """Return the finding on speed and load; add the histogram to ``figures``."""
    names = [
        next((n for n in choice if all(n in r.names for r in recordings)), None)
        for choice in (SPEED, LOAD)
    ]
    if names[0] is None or names[1] is None:
        text = "no columns of engine speed and load in all recordings: coverage is not judged"
        return [Finding("ok", "coverage", text)]
    pairs = [np.column_stack([r.column(str(n)) for n in names]) for r in recordings]
    both = np.concatenate(pairs)
    both = both[np.isfinite(both).all(axis=1)]
    if not len(both):
        text = f"{names[0]} and {names[1]} are never valid together"
        return [Finding("warning", "coverage", text)]
    found = measures.coverage(both[:, 0], both[:, 1], recordings[0].period_ns / 1e9)
    figures["coverage"] = {
        "speed": names[0],
        "load": names[1],
        "share": found.share,
        "fullest": found.fullest,
        "speed_edges": found.speed.tolist(),
        "load_edges": found.load.tolist(),
        "seconds": found.seconds.tolist(),
    }
    text = (
        f"{100 * found.share:.0f} % of the {measures.CELLS}×{measures.CELLS} cells between "
        f"{found.speed[0]:.4g} and {found.speed[-1]:.4g} {names[0]} and {found.load[0]:.4g} and "
        f"{found.load[-1]:.4g} {names[1]} visited, {100 * found.fullest:.0f} % of the time in the "
        "fullest"
    )
    if found.share < COVERED or found.fullest > FULLEST:
        text += (
            f"; {100 * COVERED:g} % of the cells and no cell above {100 * FULLEST:g} % are wanted"
        )
        return [Finding("warning", "coverage", text)]
    return [Finding("ok", "coverage", text)]


def excited(
    recordings: Sequence[Recording],
    data: Usable,
    inputs: Sequence[str],
    lags: int,
    figures: dict[str, Any],
) -> list[Finding]:
    """Return findings on each input and on collinearity; add the measures to ``figures``."""
    found = []
    period_s = recordings[0].period_ns / 1e9
    for i, name in enumerate(inputs):
        seen = measures.excitation([u[:, i] for u in data.u], period_s, 2 * lags)
        figures["excitation"].append(
            {
                "input": name,
                "std": seen.std,
                "moving": seen.moving,
                "moves": seen.moves,
                "order": seen.order,
                "order_tested": 2 * lags,
                "bandwidth_hz": seen.bandwidth_hz,
            }
        )
        if seen.moves == 0:
            values = np.concatenate([r.column(name) for r in recordings])
            if np.ptp(values[np.isfinite(values)]) > 0.0:  # otherwise another finding says it
                text = f"{name} is constant where all inputs are valid: leave it out"
                found.append(Finding("error", "constant", text))
        elif seen.order < lags:
            text = (
                f"{name} is persistently exciting of order {seen.order} only, {lags} is wanted for "
                f"{lags} lags: its lags cannot be told apart"
            )
            found.append(Finding("warning", "excitation", text))
        elif seen.moves < MOVES:
            text = (
                f"{name} changes {seen.moves} times, {MOVES} times are wanted: its effect is seen "
                "in a few places only"
            )
            found.append(Finding("warning", "excitation", text))
    if not found:
        text = f"every input moves and excites {lags} lags"
        found.append(Finding("ok", "excitation", text))
    return found + _collinear(np.concatenate(data.u), inputs, figures)


def _collinear(u: FloatArray, inputs: Sequence[str], figures: dict[str, Any]) -> list[Finding]:
    if (u.std(axis=0) <= 1e-12 * np.maximum(1.0, np.abs(u).max(axis=0))).any():
        return []  # another finding says it, or the input is constant in the usable stretches
    condition, groups = measures.collinear(u, inputs)
    figures["condition_number"] = condition
    text = f"condition number of the inputs {condition:.3g}"
    limit = measures.CONDITION_INDEX
    if condition <= limit:
        return [Finding("ok", "collinearity", f"{text}, below {limit:g}")]
    members = "; ".join(" and ".join(g) for g in groups) or "spread over all"
    text += f", below {limit:g} is wanted: {members} carry nearly the same, one may go"
    if set(inputs) == set(NARX_INPUTS):
        text += " (the paper's seven are so by their physics, and the NARX bears it)"
    return [Finding("warning", "collinearity", text)]


def copies(data: Usable, inputs: Sequence[str], output: str) -> list[Finding]:
    """Return findings on inputs that are a shifted or scaled copy of the output."""
    found = []
    transform = output_transform(output)
    rows = [np.isfinite(y) for y in data.y]
    forms = [[y[r] for y, r in zip(data.y, rows, strict=True)]]
    if transform != "none":
        forms.append([to_model_units(transform, y) for y in forms[0]])
    for i, name in enumerate(inputs):
        samples = [u[r, i] for u, r in zip(data.u, rows, strict=True)]
        level, change, lag = max(
            (measures.copy_of(samples, form, COPY_LAGS) for form in forms),
            key=lambda c: abs(c[0]),
        )
        if abs(level) <= measures.COPY:
            continue
        shift = f" shifted by {lag} samples" if lag else ""
        text = f"{name} follows {output}{shift} with a correlation of {level:.5f}"
        if abs(change) > measures.COPY:
            text += ": a copy of the output is no input, leave it out"
            found.append(Finding("error", "leak", text))
        else:
            text += f", changes with {change:.3f}: make sure that it is not made from the output"
            found.append(Finding("warning", "leak", text))
    if not found:
        text = f"no input is a scaled or shifted copy of {output} (within {COPY_LAGS} samples)"
        found.append(Finding("ok", "leak", text))
    return found
