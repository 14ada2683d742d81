"""Findings on the inputs: coverage, motion, copies of the output."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from monitor.base.counts import plain
from monitor.base.types import FloatArray
from monitor.model.step import to_model_units
from training.limits.data_check.samples import DataFinding
from training.recordings.metrics import correlations
from training.recordings.recording import Recording
from training.recordings.samples.preparation import Stretches, output_transform

MOVES = 20  # least changes of an input; with fewer, few places show its effect
MOVING = 0.001  # least change between two samples that counts as motion, as a share of the span
COVERED = 0.5  # least share of visited speed × load cells; a regulatory cycle visits 0.7 and more
FULLEST = 0.5  # largest share of samples in one cell; above it most samples are one operating point
CELLS = 8  # of the histogram, per axis
VISITED_S = 1.0  # least time in a visited cell
VISITED_SHARE = 0.1  # the same for short recordings, as a share of the time under even spread
COPY = 0.999  # correlation above which one signal is a copy of the other
COPY_LAGS = 20  # largest shift between an input and the output that the search for copies tries
SPEED = ("engine_speed_rpm", "speed_z", "rpm", "engine_speed", "speed")
LOAD = ("manifold_pressure_kpa", "air_mass_mg", "load_z", "map_kpa", "load", "engine_torque_nm")


def covered(recordings: Sequence[Recording], figures: dict[str, Any]) -> DataFinding:
    """Return the finding on the coverage of speed and load; store its histogram in ``figures``."""
    speed, load = (
        next((n for n in choice if all(n in r.names for r in recordings)), "")
        for choice in (SPEED, LOAD)
    )
    if not (speed and load):
        text = "no columns of engine speed and load in all recordings: coverage is not judged"
        return DataFinding("ok", "coverage", text)
    both = np.concatenate([np.column_stack([r.column(speed), r.column(load)]) for r in recordings])
    both = both[np.isfinite(both).all(axis=1)]
    if not len(both):
        return DataFinding("warning", "coverage", f"{speed} and {load} are never valid together")
    cover = coverage(both[:, 0], both[:, 1], recordings[0].period_ns / 1e9)
    figures["coverage"] = {"speed": speed, "load": load, **cover}
    across, up = cover["speed_edges"], cover["load_edges"]
    text = (
        f"{100 * cover['share']:.0f} % of the {CELLS}×{CELLS} cells between "
        f"{plain(across[0])} and {plain(across[-1])} {speed} and {plain(up[0])} and "
        f"{plain(up[-1])} {load} visited, {100 * cover['fullest']:.0f} % of the time in the fullest"
    )
    if cover["share"] >= COVERED and cover["fullest"] <= FULLEST:
        return DataFinding("ok", "coverage", text)
    wanted = f"{100 * COVERED:g} % of the cells and no cell above {100 * FULLEST:g} % are wanted"
    return DataFinding("warning", "coverage", f"{text}; {wanted}")


def coverage(speed: FloatArray, load: FloatArray, period_s: float) -> dict[str, Any]:
    """Return the coverage by samples of speed and load, both (n,), as JSON values.

    ``share`` : of the cells that are visited; ``fullest`` : of the samples in the fullest cell
    ``speed_edges``, ``load_edges`` : in the units of the signals, from the 0.5 % to the 99.5 %
        quantile; ``seconds`` : time in the cells, speed × load
    """
    across, up = (np.linspace(*_extremes(values), CELLS + 1) for values in (speed, load))
    counts, *_ = np.histogram2d(speed, load, bins=[across, up])
    seconds, total = counts * period_s, max(float(counts.sum()), 1.0)
    enough_s = min(VISITED_S, VISITED_SHARE * total * period_s / CELLS**2)
    return {
        "share": float((seconds >= enough_s).mean()),
        "fullest": float(counts.max()) / total,
        "speed_edges": across.tolist(),
        "load_edges": up.tolist(),
        "seconds": seconds.tolist(),
    }


def _extremes(values: FloatArray) -> tuple[float, float]:
    low, high = np.percentile(values, [0.5, 99.5]).tolist()
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def excited(
    recordings: Sequence[Recording], data: Stretches, inputs: Sequence[str], figures: dict[str, Any]
) -> Iterator[DataFinding]:
    """Yield the findings on how the inputs move; store the measures in ``figures``."""
    for i, name in enumerate(inputs):
        own = _motion(data.each(data.u[:, i]))
        figures["excitation"].append({"input": name, **own})
        if own["moves"] == 0:
            values = np.concatenate([r.column(name) for r in recordings])
            if np.ptp(values[np.isfinite(values)]) > 0.0:  # else ``usable`` has reported it
                text = f"{name} is constant where all inputs are valid: leave it out"
                yield DataFinding("error", "constant", text)
        elif own["moves"] < MOVES:
            text = (
                f"{name} changes {own['moves']} times, {MOVES} times are wanted: its effect is "
                "seen in a few places only"
            )
            yield DataFinding("warning", "excitation", text)


def _motion(stretches: Sequence[FloatArray]) -> dict[str, Any]:
    """Return how an input moves in its unbroken stretches, shapes (n_i,), as JSON values.

    ``std`` : in its unit; ``moves`` : samples that differ from the sample before; ``moving`` :
    share of those that differ by more than 0.1 % of the span
    """
    values = np.concatenate(stretches)
    low, high = np.percentile(values, [0.5, 99.5])
    span = float(high - low) or float(np.ptp(values))
    steps = np.concatenate([np.abs(np.diff(s)) for s in stretches])
    return {
        "std": float(values.std()),
        "moves": int((steps > 1e-9 * span).sum()) if span > 0 else 0,
        "moving": float((steps > MOVING * span).mean()) if span > 0 and len(steps) else 0.0,
    }


def copies(data: Stretches, inputs: Sequence[str], output: str) -> Iterator[DataFinding]:
    """Yield the findings on inputs that are a shifted or scaled copy of the output."""
    transform = output_transform(output)
    rows = [np.isfinite(y) for y in data.each(data.y)]

    def valid(values: FloatArray) -> list[FloatArray]:
        return [x[r] for x, r in zip(data.each(values), rows, strict=True)]

    forms = [valid(to_model_units(of, data.y)) for of in dict.fromkeys(("none", transform))]
    for i, name in enumerate(inputs):
        values = valid(data.u[:, i])
        level, change, lag = max((_copy(values, form) for form in forms), key=lambda c: abs(c[0]))
        if abs(level) <= COPY:
            continue
        shift = f" shifted by {lag} samples" if lag else ""
        text = f"{name} follows {output}{shift} with a correlation of {level:.5f}"
        told = f", changes with {change:.3f}: make sure that it is not made from the output"
        if is_copy := abs(change) > COPY:
            told = ": a copy of the output is no input, leave it out"
        yield DataFinding("error" if is_copy else "warning", "leak", f"{text}{told}")


def _copy(u: Sequence[FloatArray], y: Sequence[FloatArray]) -> tuple[float, float, int]:
    """Return correlation of levels, correlation of changes, and the lag of their best match.

    u, y : unbroken stretches of input and output, shapes (n_i,); the lag is positive if ``u``
        follows ``y``
    """
    long = [(a, b) for a, b in zip(u, y, strict=True) if len(a) > 2 * COPY_LAGS + 2]
    if not long:
        return 0.0, 0.0, 0
    swapped = [(b, a) for a, b in long]
    levels = [*correlations(long, COPY_LAGS)[:0:-1], *correlations(swapped, COPY_LAGS)]
    lag = int(np.argmax(np.abs(levels))) - COPY_LAGS
    changes = [(np.diff(a), np.diff(b)) for a, b in (swapped if lag > 0 else long)]
    return levels[lag + COPY_LAGS], correlations(changes, abs(lag))[-1], lag
