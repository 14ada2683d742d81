"""Proof that a network's file with effects agrees with numpy, alone and in a batch.

The network is that of ``parity``; the chains' difference is that of the arrays.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from monitor.base.errors import ModelError
from monitor.base.types import FloatArray
from monitor.model.step import Model
from training.gap.add.network_graph import TO_OUTPUT, NetworkWithEffects
from training.greybox.fit.drive import ChainDrive
from training.narx.network import simulate
from training.narx.parity import TOLERANCE, Parity
from training.recordings.prediction import stacked
from training.recordings.samples.transforms import apply

SAMPLES = 3000  # of each drive
TOGETHER = 300  # samples that run side by side and alone


class ParityError(ModelError):
    """ONNX and numpy compute different values for a model with effects."""


def parity(path: Path | str, model: NetworkWithEffects, drives: Sequence[ChainDrive]) -> Parity:
    """Compare free runs of a file with those of numpy over ``drives``.

    The network starts from the measured output, the chains settled at the first sample. Returned
    are the samples of all runs, and the run that differs most of what it may.
    Raises ParityError if a difference exceeds 2e-3 of the standard deviation of the run's output,
    or if runs side by side are not bit for bit those alone.
    """
    runs = [_of_drive(model, drive) for drive in drives]
    exact = [_numpy(model, u, y) for u, y in runs]
    y = stacked([y for _, y in runs])
    onnx = _onnx(path, model, stacked([u for u, _ in runs]), y)
    each = [_compared(model, *run) for run in zip(exact, onnx, strict=True)]
    worst = max(each, key=lambda found: found.onnx_numpy / found.tolerance)
    if not worst.onnx_numpy <= worst.tolerance:
        raise ParityError(
            f"{path}: free runs in ONNX and numpy differ by {worst.onnx_numpy:.2g}, "
            f"tolerance {worst.tolerance:.2g}"
        )
    _check_batch(path, runs[0][0])
    return replace(worst, samples=sum(found.samples for found in each))


def _compared(model: NetworkWithEffects, run: FloatArray, onnx: FloatArray) -> Parity:
    """Return how far ONNX is from numpy.

    run : (n - memory,) in numpy
    onnx : (n,) or longer
    """
    first = model.network.spec.memory
    off = np.abs(onnx[first : first + len(run)] - run)
    return Parity(len(run), float(off.max()), TOLERANCE * float(run.std()))


def _of_drive(model: NetworkWithEffects, drive: ChainDrive) -> tuple[FloatArray, FloatArray]:
    """Return inputs as the graph gets them and the measured output in model units."""
    u = np.column_stack([drive.signals[name] for name in model.inputs])[:SAMPLES]
    y = drive.phi_measured[:SAMPLES]
    scale = model.network.scaling
    return _single(u), np.clip(y, scale.y_low, scale.y_high)


def _single(u: FloatArray) -> FloatArray:
    return u.astype(np.float32).astype(np.float64)


def _numpy(model: NetworkWithEffects, u: FloatArray, y: FloatArray) -> FloatArray:
    """Return the output (n - memory,) of the whole after the first samples."""
    net = model.network
    spec, scale, first = net.spec, net.scaling, net.spec.memory
    inputs, difference = model.split(u)
    scaled = scale.scale_u(apply(net.transforms, net.inputs, inputs))
    history = scale.scale_y(y[first - spec.lags : first])[::-1][None].copy()
    begin, end = np.array([first]), np.array([len(u)])
    own = scale.unscale_y(
        simulate(spec, net.weights, u=scaled, start=begin, stop=end, history=history)
    )
    return model.whole(own, difference)[first:]


def _onnx(path: Path | str, model: NetworkWithEffects, u: FloatArray, y: FloatArray) -> FloatArray:
    """Return the output (runs, n) for inputs (runs, n, k) and measured outputs (runs, n)."""
    loaded = Model.load(path, len(u))
    loaded.reset(u[:, 0])
    for _ in range(model.memory):
        loaded.step_batch(u[:, 0])
    newest, part = loaded.card.state.output_start, model.network.state_layout.size
    found = np.empty(y.shape)
    for k in range(y.shape[1]):
        loaded.step_batch(u[:, k])
        if k < model.network.spec.memory:  # the network's own output is the measured one
            more = loaded.state[:, part] if model.form == TO_OUTPUT else 0.0
            loaded.state[:, newest] = y[:, k] + more
        found[:, k] = loaded.state[:, newest]
    return found


def _check_batch(path: Path | str, u: FloatArray) -> None:
    """Raise ParityError if runs over a drive's begin and end differ side by side from alone."""
    both = np.stack([u[:TOGETHER], u[-TOGETHER:]])
    runs = []
    for rows in (both, both[:1], both[1:]):
        model = Model.load(path, len(rows))
        model.reset(rows[:, 0])
        runs.append(model.run_batch(rows))
    if not np.array_equal(runs[0], np.concatenate(runs[1:])):
        raise ParityError(f"{path}: runs side by side differ from the same runs alone")
