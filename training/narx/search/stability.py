"""Contraction: two runs with the same inputs and different histories end at the same prediction."""

from dataclasses import dataclass, replace

import numpy as np

from monitor.base.types import FloatArray
from training.narx.network import Spec, simulate
from training.recordings.samples.preparation import LAMBDA_MEMORY, Prepared

CONTRACTION_SAMPLES = LAMBDA_MEMORY  # unless the data say another memory
CONTRACTION_LIMIT = 0.01  # phi; other outputs: the same share of their range
PHI_SPAN = 1.7
STEPS = 100_000  # of all pairs together: 2,000 pairs over 50 samples


@dataclass(frozen=True, slots=True)
class Contraction:
    """The largest difference after ``samples`` samples among all pairs, in model units."""

    gap: float
    limit: float
    pairs: int
    samples: int = CONTRACTION_SAMPLES


def contraction(data: Prepared, spec: Spec, weights: FloatArray, seed: int) -> Contraction:
    """Return how far predictions from random pairs of histories are apart after a while.

    The while is the data's memory, or 50 samples if they have none. The pairs run over the inputs
    of random places of all recordings, and over the inputs of single samples held for all of the
    while: a drive may stay at an operating point for longer than any recording did, and a network
    that forgets only because the inputs move on may have two steady states there.
    """
    rng = np.random.default_rng(seed)
    samples = data.memory or CONTRACTION_SAMPLES
    pairs = STEPS // samples
    length = samples + 1
    places = np.concatenate(
        [
            np.arange(s.start + spec.memory, max(s.stop - length, s.start + spec.memory + 1))
            for s in data.segments
        ]
    )
    rows = np.arange(-spec.memory, length)
    moving = np.minimum(rng.choice(places, pairs)[:, None] + rows, len(data.samples.y) - 1)
    points = rng.choice(np.flatnonzero(data.samples.weight > 0), max(1, STEPS // len(rows) // 2))
    held = np.repeat(points[:, None], len(rows), axis=1)
    gap = max(_gap(spec, weights, data.samples.u[at], rng) for at in (moving, held))
    span = data.scaling.y_high - data.scaling.y_low
    limit = CONTRACTION_LIMIT * span / PHI_SPAN
    return Contraction(gap * data.scaling.y_std, limit, pairs + len(points), samples)


def settling(data: Prepared, spec: Spec, weights: FloatArray, seed: int) -> Contraction:
    """Return the contraction after 50 samples, or twice, four times as many, that first suffice.

    That after 50 if none up to the longest block does.
    """
    first = found = contraction(data, spec, weights, seed)
    while found.gap > found.limit and 2 * found.samples <= data.longest_block:
        found = contraction(replace(data, memory=2 * found.samples), spec, weights, seed)
    return found if found.gap <= found.limit else first


def _gap(spec: Spec, weights: FloatArray, u: FloatArray, rng: np.random.Generator) -> float:
    """Return the largest difference at the end of runs from two histories each, scaled units.

    u : (n_runs, rows, n_inputs), the model's memory first
    Histories are drawn evenly over the output's range (phi 0 .. 1.7), half of them constant; one
    pair in eight starts at the two ends of the range.
    """
    count, rows, _ = u.shape
    stop = rows * np.arange(1, count + 1)
    start, flat, ends = stop - rows + spec.memory, u.reshape(count * rows, -1), []
    for side in (0, 1):
        history = rng.uniform(spec.y_min, spec.y_max, size=(count, spec.lags))
        history[::2] = history[::2, :1]
        history[: count // 8] = spec.y_max if side else spec.y_min
        run = simulate(spec, weights, u=flat, start=start, stop=stop, history=history)
        ends.append(run[stop - 1])
    return float(np.abs(ends[0] - ends[1]).max())
