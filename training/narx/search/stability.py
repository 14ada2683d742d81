"""Contraction: two runs with the same inputs and different histories end at the same prediction."""

from dataclasses import dataclass

import numpy as np

from monitor.base.counts import plain
from monitor.base.types import FloatArray, IntArray
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

    @property
    def forgets(self) -> bool:
        """Whether the histories no longer matter after these samples."""
        return self.gap <= self.limit  # False for NaN

    def warnings(self) -> list[str]:
        """Return the sentence about a history that matters for too long, none if it does not."""
        gap, limit = plain(self.gap, 3), plain(self.limit, 3)
        told = f"differ by up to {gap} after {self.samples} samples (limit {limit})"
        return [] if self.forgets else [f"two runs that begin with different past values {told}"]


def contraction(data: Prepared, spec: Spec, weights: FloatArray, seed: int) -> Contraction:
    """Return how far predictions from random pairs of histories are apart after a while.

    The while is the data's memory, or 50 samples if they have none. The pairs run over the inputs
    of random places of all recordings, and over the inputs of single samples held for all of the
    while: a drive may stay at an operating point for longer than any recording did, and a network
    that forgets only because the inputs move on may have two steady states there.
    """
    rng = np.random.default_rng(seed)
    samples = data.memory or CONTRACTION_SAMPLES
    moving = _moving(data, spec, samples, rng)
    rows = moving.shape[1]
    points = rng.choice(np.flatnonzero(data.samples.weight > 0), max(1, STEPS // rows // 2))
    held = np.repeat(points[:, None], rows, axis=1)
    gap = max(
        _gap(spec, weights, data.samples.u[at], *_far_apart(spec, len(at), rng))
        for at in (moving, held)
    )
    return _found(data, gap, len(moving) + len(points), samples)


def settling(data: Prepared, spec: Spec, weights: FloatArray, seed: int) -> Contraction:
    """Return the contraction after 50 samples, or twice, four times as many, that first suffice.

    That after 50 if none up to the longest block does. After a break of the inputs a run begins at
    a reading, so the pairs have recorded histories, and run over the inputs of recorded places.
    """
    first, samples = None, data.memory or CONTRACTION_SAMPLES
    while first is None or samples <= data.longest_block:
        rng = np.random.default_rng(seed)
        moving = _moving(data, spec, samples, rng)
        own = data.samples.y[rng.choice(np.flatnonzero(data.samples.weight > 0), (2, len(moving)))]
        histories = np.repeat(own[:, :, None], spec.lags, axis=2)
        gap = _gap(spec, weights, data.samples.u[moving], *histories)
        found = _found(data, gap, len(moving), samples)
        if found.forgets:
            return found
        first, samples = first or found, 2 * samples
    return first


def _found(data: Prepared, gap: float, pairs: int, samples: int) -> Contraction:
    limit = CONTRACTION_LIMIT * (data.scaling.y_high - data.scaling.y_low) / PHI_SPAN
    return Contraction(gap * data.scaling.y_std, limit, pairs, samples)


def _moving(data: Prepared, spec: Spec, samples: int, rng: np.random.Generator) -> IntArray:
    """Return the rows of runs from random places (n_runs, rows), the model's memory first."""
    begins = [(s.start + spec.memory, s.stop - samples - 1) for s in data.segments]
    places = np.concatenate([np.arange(first, max(last, first + 1)) for first, last in begins])
    chosen = rng.choice(places, STEPS // samples)[:, None]
    rows = chosen + np.arange(-spec.memory, samples + 1)
    return np.minimum(rows, len(data.samples.y) - 1)


def any_histories(spec: Spec, count: int, rng: np.random.Generator) -> FloatArray:
    """Return histories (count, lags) drawn evenly over the scaled output range, half constant."""
    histories = rng.uniform(spec.y_min, spec.y_max, size=(count, spec.lags))
    histories[::2] = histories[::2, :1]
    return histories


def _far_apart(spec: Spec, count: int, rng: np.random.Generator) -> list[FloatArray]:
    """Return two sets of any histories; one pair in eight starts at the two ends of the range."""
    both = [any_histories(spec, count, rng) for _ in range(2)]
    for histories, end in zip(both, (spec.y_min, spec.y_max), strict=True):
        histories[: count // 8] = end
    return both


def _gap(
    spec: Spec, weights: FloatArray, u: FloatArray, one: FloatArray, other: FloatArray
) -> float:
    """Return the largest difference at the end of runs from two histories each, scaled units.

    u : (n_runs, rows, n_inputs), the model's memory first
    """
    count, rows, _ = u.shape
    stop = rows * np.arange(1, count + 1)
    start, flat = stop - rows + spec.memory, u.reshape(count * rows, -1)
    ends = [
        simulate(spec, weights, u=flat, start=start, stop=stop, history=each)[stop - 1]
        for each in (one, other)
    ]
    return float(np.abs(ends[0] - ends[1]).max())
