"""One training from one start: series-parallel, then closed loop over growing horizons.

A good one-step prediction says nothing about free run, and the full horizon can hurt, so every
stage is judged by free-run validation and the best weights of all stages are kept. From horizon 20
on, stretches that start from random histories and are scored only after they should have been
forgotten train the contraction in.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from monitor.types import FloatArray, IntArray
from training.closed_loop import ClosedLoop, Pieces
from training.lm import Options, Outcome, minimise
from training.narx import Spec, initial_weights, simulate
from training.prepare import Prepared, Role
from training.stability import contraction

HORIZONS = (5, 20, 100, 1000)
EPOCHS = {1: 40, 5: 15, 20: 15, 100: 20, 1000: 30}  # most epochs of each stage
FORGET_FROM = 20  # horizon from which random histories take part
FORGET = 30  # samples after which a random history must no longer matter
RANDOM_LENGTH = 80  # samples of a stretch that starts from a random history
RANDOM_SHARE = 0.15  # of the training samples
FORGET_SHARE, FORGET_EPOCHS = 1.0, 25  # of the last stage, if there must be one
CONTRACTION_SEED = 1  # other histories than those of the final check


@dataclass(frozen=True, slots=True)
class Stage:
    """What one stage of the training did."""

    name: str  # "horizon 1" is series-parallel; "forget" tunes on random histories
    costs: tuple[float, ...]  # training cost after every epoch, scaled units
    scores: tuple[float, ...]  # free-run validation RMSE after every epoch, scaled units
    stop: str
    seconds: float


@dataclass(slots=True)
class Trained:
    """The best weights of one start."""

    weights: FloatArray
    score: float  # free-run validation RMSE, scaled and weighted
    stages: list[Stage] = field(default_factory=list)


def measured_history(data: Prepared, lags: int, start: IntArray) -> FloatArray:
    """Return (n_pieces, lags) measured outputs before every start, newest first, scaled."""
    return np.asarray(data.samples.y[start[:, None] - np.arange(1, lags + 1)])


def free_run(data: Prepared, spec: Spec, weights: FloatArray) -> FloatArray:
    """Return scaled free-run predictions (n,) of every whole segment; NaN in its first lags."""
    start = np.array([s.start + spec.lags for s in data.segments], dtype=np.int64)
    stop = np.array([s.stop for s in data.segments], dtype=np.int64)
    history = measured_history(data, spec.lags, start)
    return simulate(spec, weights, data.samples.u, start, stop, history)


def free_run_score(
    data: Prepared, spec: Spec, weights: FloatArray, role: Role = Role.VALIDATE
) -> float:
    """Return the weighted free-run RMSE on the blocks of ``role``, in scaled units."""
    predicted = free_run(data, spec, weights)
    rows = (data.role == role) & np.isfinite(predicted)
    weight = data.samples.weight[rows]
    squares = (predicted[rows] - data.samples.y[rows]) ** 2
    return float(np.sqrt(weight @ squares / weight.sum()))


def pieces(data: Prepared, lags: int, horizon: int) -> Pieces:
    """Return the training blocks cut into stretches of at most ``horizon`` samples."""
    starts: list[int] = []
    stops: list[int] = []
    for segment in data.segments:
        role = data.role[segment.start : segment.stop]
        edges = segment.start + np.flatnonzero(np.diff(role)) + 1
        bounds = [segment.start, *edges.tolist(), segment.stop]
        for first, stop in pairwise(bounds):
            if data.role[first] == Role.TRAIN:
                begin = np.arange(max(first, segment.start + lags), stop, horizon)
                starts += begin.tolist()
                stops += np.minimum(begin + horizon, stop).tolist()
    start, stop_rows = np.array(starts, dtype=np.int64), np.array(stops, dtype=np.int64)
    skip = np.zeros_like(start)
    return Pieces(start, stop_rows, skip, measured_history(data, lags, start))


def random_pieces(
    data: Prepared, spec: Spec, rng: np.random.Generator, count: int, length: int, skip: int
) -> Pieces:
    """Return stretches of training samples from histories drawn evenly over the output's range."""
    train = pieces(data, spec.lags, length)
    whole = np.flatnonzero(train.stop - train.start == length)
    if not len(whole):
        return Pieces(train.start[:0], train.stop[:0], train.skip[:0], train.history[:0])
    start = train.start[rng.choice(whole, count)]
    history = rng.uniform(spec.y_min, spec.y_max, size=(count, spec.lags))
    history[::2] = history[::2, :1]  # every other one is constant
    return Pieces(start, start + length, np.full_like(start, skip), history)


def train(
    data: Prepared,
    spec: Spec,
    seed: int,
    deadline_s: float = np.inf,
    progress: Callable[[int, int, float], None] | None = None,
    horizons: tuple[int, ...] = HORIZONS,
) -> Trained:
    """Return the best weights of one start from random weights.

    progress : called with horizon, epoch and best validation score after every epoch
    """
    rng = np.random.default_rng(seed)
    return tune(data, spec, initial_weights(spec, rng), rng, deadline_s, progress, (1, *horizons))


def tune(
    data: Prepared,
    spec: Spec,
    weights: FloatArray,
    rng: np.random.Generator,
    deadline_s: float = np.inf,
    progress: Callable[[int, int, float], None] | None = None,
    horizons: tuple[int, ...] = HORIZONS,
) -> Trained:
    """Return the best weights by free-run validation on the way through ``horizons``."""
    best = Trained(weights, np.inf)
    n_train = int((data.role == Role.TRAIN).sum())
    count = int(RANDOM_SHARE * n_train / RANDOM_LENGTH)
    random = random_pieces(data, spec, rng, count, RANDOM_LENGTH, FORGET)
    for horizon in horizons:
        if time.monotonic() > deadline_s:
            if best.stages:
                best.stages[-1] = replace(best.stages[-1], stop="budget")
            break
        cut = pieces(data, spec.lags, horizon)
        objective = ClosedLoop(spec, data.samples, cut + random if horizon >= FORGET_FROM else cut)
        began = time.monotonic()
        outcome = minimise(
            objective,
            weights,
            Options(epochs=EPOCHS.get(horizon, 30), max_fail=8 if horizon > 1 else 40),
            validate=lambda w: free_run_score(data, spec, w),
            deadline_s=deadline_s,
            progress=_tell(progress, horizon, best),
        )
        best.stages.append(_stage(f"horizon {horizon}", outcome, began))
        if outcome.score < best.score:
            best.weights, best.score = outcome.weights, outcome.score
        weights = outcome.weights
    if np.isfinite(best.score):
        _learn_to_forget(data, spec, best, rng, deadline_s)
    return best


def _learn_to_forget(
    data: Prepared, spec: Spec, best: Trained, rng: np.random.Generator, deadline_s: float
) -> None:
    """Tune ``best`` on many random histories, if two of them still matter after a window.

    Weights that forget replace those that do not, weights that do not only if that helped.
    """

    def penalised(weights: FloatArray) -> float:
        found = contraction(data, spec, weights, CONTRACTION_SEED)
        return free_run_score(data, spec, weights) * max(1.0, found.gap / found.limit)

    before = penalised(best.weights)
    if before <= best.score or time.monotonic() > deadline_s:
        return
    count = int(FORGET_SHARE * (data.role == Role.TRAIN).sum() / RANDOM_LENGTH)
    many = random_pieces(data, spec, rng, count, RANDOM_LENGTH, FORGET)
    objective = ClosedLoop(spec, data.samples, pieces(data, spec.lags, 100) + many)
    began = time.monotonic()
    options = Options(epochs=FORGET_EPOCHS, max_fail=8)
    outcome = minimise(objective, best.weights, options, penalised, deadline_s)
    best.stages.append(_stage("forget", outcome, began))
    if outcome.score < before:
        best.weights = outcome.weights
        best.score = free_run_score(data, spec, outcome.weights)


def _stage(name: str, outcome: Outcome, began_s: float) -> Stage:
    costs, scores = tuple(outcome.costs), tuple(outcome.scores)
    return Stage(name, costs, scores, outcome.stop, time.monotonic() - began_s)


def _tell(
    progress: Callable[[int, int, float], None] | None, horizon: int, best: Trained
) -> Callable[[int, float], None] | None:
    if progress is None:
        return None
    return lambda epoch, _: progress(horizon, epoch, best.score)
