"""The best linear model of the samples: as a first network, and as the measure of their memory.

An ARX is a NARX without hidden layers, so it is trained further, judged and exported as any other
start. With it among the starts, a fit follows the held-out blocks at least as well as an ARX.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.signal import lfilter, lfiltic

from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from training.narx.linear.arx import Arx, choose_arx
from training.narx.linear.regressors import Stretch
from training.narx.network import Spec
from training.narx.search.stability import CONTRACTION_LIMIT, CONTRACTION_SAMPLES, PHI_SPAN
from training.narx.search.stages import RANDOM_LENGTH, Stage, Trained, free_run_score, train
from training.narx.work import Work
from training.recordings.samples.augmentation import FUEL
from training.recordings.samples.preparation import Prepared, Role
from training.recordings.samples.rows import runs

MAX_ORDER: Final = 20  # of the ARX; its inputs have up to twice as many lags
HORIZONS: Final = (100, 1000)  # of the further training on the error of the free run
REFINED_SAMPLES: Final = 25_000  # most training samples of it
MEMORY_MARGIN: Final = 2.0  # a network may remember for longer than the linear model


def best_arx(data: Prepared) -> Arx | None:
    """Return the ARX with the best free run on the validation blocks, in scaled units.

    None if the samples are too few for linear models.
    """
    try:
        return choose_arx(stretches(data, Role.TRAIN), stretches(data, Role.VALIDATE), MAX_ORDER)
    except RecordingError:
        return None


def linear_starts(folds: Sequence[Prepared], arx: Arx, work: Work) -> tuple[Trained, ...]:
    """Return the first fold's ARX as a network, and the same trained further in free run.

    The score of each is the mean over the folds, each of which has an ARX of its own.
    """
    models = [arx, *map(best_arx, folds[1:])]
    found = [_linear(fold, own, work) for fold, own in zip(folds, models, strict=True) if own]
    return tuple(
        replace(same[0], score=float(np.mean([each.score for each in same])))
        for same in zip(*filter(None, found), strict=True)
        if found[0]
    )


def _linear(data: Prepared, arx: Arx, work: Work) -> tuple[Trained, ...]:
    spec, weights = as_network(arx, data)
    try:
        score = free_run_score(data, spec, weights)
    except RecordingError:  # no block is as long as its lags
        return ()
    solved = Stage("ARX", (), (score,), "least squares")
    plain = Trained(spec, weights, score, [solved])
    if not np.isfinite(score):
        return ()
    further = train(
        data,
        spec,
        seed=0,
        work=work,
        horizons=HORIZONS,
        n_samples=REFINED_SAMPLES,
        weights=weights,
    )
    return plain, further


def with_memory(data: Prepared, arx: Arx) -> Prepared:
    """Return the data with the memory of their linear model.

    It is twice the time after which the ARX has forgotten any history up to the limit, and one
    window at least. Where the blocks are too short to show it, lambda must be forgotten within the
    longest time that they show, and other outputs, which may integrate, need not be. If the linear
    model integrates, the data stay as they are, and where fuel is an input: the mixture then
    follows from it at once. Without it, lambda follows an aim of the ECU, which may be slow, such
    as the enrichment that cools hot parts.
    """
    if not arx.stable or (data.memory and FUEL in data.names):
        return data
    longest = data.longest_block
    memory = max(CONTRACTION_SAMPLES, round(MEMORY_MARGIN * settling(arx, longest)))
    shown = int(longest / RANDOM_LENGTH)
    if memory > shown and not data.memory:
        return data
    return replace(data, memory=max(data.memory, min(memory, shown)))


def settling(arx: Arx, most: int) -> int:
    """Return the samples after which a step of the past outputs has died away, ``most`` at most.

    The past outputs are one, and the inputs zero; died away is a hundredth of phi's range.
    """
    past = lfiltic([1.0], arx.poly, np.ones(len(arx.a)))
    free, _ = lfilter([1.0], arx.poly, np.zeros(most), zi=past)
    alive = np.flatnonzero(np.abs(free) > CONTRACTION_LIMIT / PHI_SPAN)
    return int(alive.max(initial=-1)) + 1


def stretches(data: Prepared, role: Role) -> list[Stretch]:
    """Return the scaled inputs (n, k) and outputs (n,) of every unbroken stretch of ``role``."""
    found = []
    for segment in data.segments:
        rows = slice(segment.start, segment.stop)
        use = (data.role[rows] == role) & (data.samples.weight[rows] > 0)
        for first, stop in runs(use):
            part = slice(segment.start + first, segment.start + stop)
            found.append((data.samples.u[part], data.samples.y[part]))
    return found


def as_network(arx: Arx, data: Prepared) -> tuple[Spec, FloatArray]:
    """Return shape and weights of the network without hidden layers that equals the ARX."""
    n_lags, lags = max(arx.delays) + arx.b.shape[1], max(1, len(arx.a))
    inputs = np.zeros((n_lags, len(arx.delays)))  # newest first
    for i, (delay, b) in enumerate(zip(arx.delays, arx.b, strict=True)):
        inputs[delay : delay + len(b), i] = b
    outputs = np.zeros(lags)
    outputs[: len(arx.a)] = -arx.a
    spec = Spec(
        len(data.inputs),
        lags,
        (),
        0,
        *data.scaling.y_scaled_limits,
        tuple((lag, lag + 1) for lag in range(n_lags)),
    )
    return spec, np.concatenate([inputs.ravel(), outputs, [arx.offset]])
