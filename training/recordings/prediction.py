"""The predictions of a model file for many recordings side by side."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.runs import runs
from monitor.base.types import BoolArray, FloatArray
from monitor.model.card import ModelCard
from monitor.model.step import Model, from_model_units, to_model_units
from training.recordings.recording import Recording
from training.recordings.samples.preparation import readings
from training.recordings.samples.rows import hold

ROWS: Final = 32  # recordings that run side by side
REMEMBERED: Final = 100  # free runs, the newest: the steps of a workflow ask for the same again

Key = tuple[str, str]  # sha256 of the model's file, and of inputs and measured output
_memory: Final[dict[Key, FloatArray]] = {}  # the oldest first


def predicted_phi(model: Path, recordings: Sequence[Recording]) -> list[FloatArray]:
    """Return the free run of a model over each recording, (n,) in phi, in their order.

    An input without a good value keeps its last one. Until the model's longest lag after the first
    good measurement, the measurement drives the state. Outputs other than lambda are in their unit.
    Raises ModelError if the file is no model, RecordingError if a recording has another sample
    period, lacks a signal or never has a good value of it.
    """
    loaded = Model.load(model)
    rows = [checked(loaded, recording) for recording in recordings]
    digests = [hashlib.sha256(b"".join(map(np.ndarray.tobytes, row))).hexdigest() for row in rows]
    keys = [(loaded.sha256, digest) for digest in digests]
    found = {key: _memory.pop(key) for key in {*keys} & _memory.keys()}
    new = {key: row for key, row in zip(keys, rows, strict=True) if key not in found}
    order = sorted(new, key=lambda key: len(new[key][1]))  # similar lengths side by side
    for first in range(0, len(order), ROWS):
        chosen = order[first : first + ROWS]
        runs = _run(loaded.with_batch(len(chosen)), [new[key] for key in chosen])
        found |= zip(chosen, runs, strict=True)
    _memory.update(found)
    for key in list(_memory)[:-REMEMBERED]:
        del _memory[key]
    return [found[key].copy() for key in keys]


def checked(model: Model, recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Return held inputs (n, n_inputs) and the measured output (n,), NaN where not good."""
    card = model.card
    check_period(recording, card)
    check_signals(recording, card)
    inputs = np.stack([hold(recording.column(name)) for name in card.input_names], axis=1)
    return inputs, recording.column(card.output.name)


def check_signals(recording: Recording, card: ModelCard) -> None:
    """Raise RecordingError if a signal of the model is missing or never good."""
    for name in (*card.input_names, card.output.name):
        if not np.isfinite(recording.column(name)).any():
            raise RecordingError(f"{recording.path}: {name} is never good, the model needs it")


def check_period(recording: Recording, card: ModelCard) -> None:
    """Raise RecordingError if recording and model differ in their sample period."""
    if recording.period_ns != card.period_ns:
        raise RecordingError(
            f"{recording.path}: sample period {recording.period_ns / 1e9:g} s, "
            f"the model has {card.period_ns / 1e9:g} s, to which recordings come without --period"
        )


def predict(
    model: Model, recording: Recording, washout: int
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Return measured, free-run and one-step output (n,) and a mask of the scored rows (n,) bool.

    A stretch begins where all inputs and the output are valid and ends at an invalid input. The
    measured output is clipped to the range of the model (lambda at most 16). As in a training, a
    reading at the end of the sensor's range outside fuel cut is none.
    Raises RecordingError if the sample periods of recording and model differ.
    """
    card = model.card
    check_period(recording, card)
    u = np.stack([recording.column(name) for name in card.input_names], axis=1)
    y = readings(recording, card.output.name)
    measured = from_model_units(card.transform, to_model_units(card.transform, y))
    both = model.with_batch(2)  # row 0 runs freely, row 1 is forced at every sample
    free, one_step = np.full(len(y), np.nan), np.full(len(y), np.nan)
    scored = np.zeros(len(y), dtype=bool)
    for first, stop in runs(np.asarray(np.isfinite(u).all(axis=1))):
        valid = np.flatnonzero(np.isfinite(y[first:stop]))
        if not len(valid):
            continue
        begin = first + int(valid[0])
        both.reset(u[begin], float(y[begin]))
        for t in range(begin, stop):
            free[t], one_step[t] = both.step_batch(u[t])
            both.force_output(np.array([y[t] if t < begin + washout else np.nan, y[t]]))
        scored[begin + washout : stop] = np.isfinite(y[begin + washout : stop])
    return measured, free, one_step, scored


def stacked(runs: Sequence[FloatArray], axis: int = 0) -> FloatArray:
    """Return runs (n, …) of different lengths n as one array; short ones repeat their last row.

    axis : axis of the runs, 0 for (runs, n, …), 1 for (n, runs, …)
    """
    longest = max(map(len, runs))
    around = [((0, longest - len(run)), *((0, 0),) * (run.ndim - 1)) for run in runs]
    padded = [np.pad(run, pad, "edge") for run, pad in zip(runs, around, strict=True)]
    return np.stack(padded, axis)


def _run(model: Model, rows: Sequence[tuple[FloatArray, FloatArray]]) -> list[FloatArray]:
    lengths = [len(measured) for _, measured in rows]
    u = stacked([inputs for inputs, _ in rows], axis=1).astype(np.float32)
    begins = [int(np.argmax(np.isfinite(measured))) for _, measured in rows]
    forced = np.full((max(begins) + model.card.lags, len(rows)), np.nan)
    for i, ((_, measured), begin) in enumerate(zip(rows, begins, strict=True)):
        own = measured[: begin + model.card.lags]
        forced[: len(own), i] = np.where(np.arange(len(own)) < begin, measured[begin], own)
    model.reset(u[0], forced[0])
    newest = model.card.state.output_start
    phi = np.empty((len(rows), len(u)))
    for k, row in enumerate(u):
        model.step_batch(row)
        phi[:, k] = model.state[:, newest]
        if k < len(forced):
            model.force_output(forced[k])
    return [run[:n].copy() for run, n in zip(phi, lengths, strict=True)]
