"""Check of a grey-box file: the start of the state is forgotten."""

from pathlib import Path

import numpy as np

from monitor.base.types import FloatArray
from monitor.model.step import Model
from training.greybox.graph.chain_graph import LAGS, Greybox
from training.greybox.quantity.value import READING
from training.narx.search.stability import CONTRACTION_LIMIT, CONTRACTION_SAMPLES, Contraction
from training.recordings.samples.preparation import Prepared

PAIRS = 500  # of random states whose predictions must come together


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
    chain = np.arange(-(LAGS + Greybox.of(model.card).register), READING + 1)  # the last, the first
    drawn = rng.uniform(*model.card.output_limits, size=(2 * pairs, len(chain)))
    model.state[:, chain] = drawn
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
