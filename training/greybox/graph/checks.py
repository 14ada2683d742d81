"""Checks of a grey-box file: ONNX equals numpy, and the start of the state is forgotten."""

from pathlib import Path

import numpy as np

from monitor.base.errors import ModelError
from monitor.base.types import FloatArray
from monitor.model.step import Model
from training.greybox.chain import simulate
from training.greybox.graph.chain_graph import Greybox
from training.narx.search.stability import CONTRACTION_LIMIT, CONTRACTION_SAMPLES, Contraction
from training.recordings.samples.preparation import Prepared

TOLERANCE = 1e-5  # phi, ONNX against numpy over a free run
PARITY_SAMPLES = 3000
PAIRS = 500  # of random states whose predictions must come together


def parity(path: Path | str, greybox: Greybox, data: Prepared) -> tuple[int, float]:
    """Return the samples compared and the largest difference of ONNX from numpy, in phi.

    Raises ModelError if it is above 1e-5.
    """
    segment = max(data.segments, key=lambda s: s.stop - s.start)
    u = physical_inputs(data)[segment.start : min(segment.stop, segment.start + PARITY_SAMPLES)]
    expected = simulate(greybox.path(greybox.signals(u)), greybox.period_s)
    model = Model.load(path)
    model.reset(u[0])
    graph = np.empty(len(u))
    for k, inputs in enumerate(u):
        model.step(inputs)
        graph[k] = model.state[0, 0]
    off = float(np.abs(graph - expected)[greybox.memory :].max())
    if not off <= TOLERANCE:
        raise ModelError(
            f"{path}: free runs of ONNX and numpy differ by {off:.2g} in phi, "
            f"tolerance {TOLERANCE:.2g}"
        )
    return len(u) - greybox.memory, off


def contraction(path: Path | str, data: Prepared, seed: int, pairs: int = PAIRS) -> Contraction:
    """Return how far predictions from random pairs of states are apart after 50 samples.

    All states of the chain are drawn evenly from phi 0 .. 1.7; the inputs start at random samples,
    at which the states of effects start settled.
    """
    rng = np.random.default_rng(seed)
    model = Model.load(path, batch=2 * pairs)
    u = physical_inputs(data)
    places = np.concatenate(
        [np.arange(s.start, max(s.stop - CONTRACTION_SAMPLES, s.start + 1)) for s in data.segments]
    )
    at = np.tile(rng.choice(places, pairs), 2)
    model.reset(u[at])
    chain = model.state[:, : 4 + Greybox.of(model.card).register]
    chain[:] = rng.uniform(*model.card.output_limits, size=chain.shape)
    for k in range(CONTRACTION_SAMPLES + 1):
        model.step_batch(u[np.minimum(at + k, len(u) - 1)])
    phi = model.state[:, model.card.state.output_start]
    return Contraction(float(np.abs(phi[:pairs] - phi[pairs:]).max()), CONTRACTION_LIMIT, pairs)


def physical_inputs(data: Prepared) -> FloatArray:
    """Return the inputs of all samples (n, n_inputs) in physical units, not clipped."""
    parts = []
    for s in data.segments:
        recording = data.recordings[s.recording]
        order = [list(recording.names).index(name) for name in data.names]
        parts.append(recording.values[s.first : s.first + s.stop - s.start, order])
    return np.concatenate(parts)
