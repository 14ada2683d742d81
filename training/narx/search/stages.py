"""The stages of one training: series-parallel, then closed loop over growing horizons.

A good one-step prediction says nothing about free run, and the full horizon can hurt. So free-run
validation judges every stage, and the training keeps the best weights of all stages. In closed
loop some stretches begin with a random history. They are scored only after the model should have
forgotten it, so that the network learns to forget.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from training.narx.algorithms.lm import LmOutcome, minimise
from training.narx.algorithms.objectives import ClosedLoop, Pieces, measured_history
from training.narx.network import Spec, initial_weights, layers, linear_path, simulate
from training.narx.search.stability import any_histories, contraction
from training.narx.work import Work, of_epoch
from training.recordings.samples.preparation import Prepared, Role

HORIZONS = (20, 100, 1000)  # samples
EPOCHS = 20  # most of each stage
N_SAMPLES = 30_000  # training samples of horizons below 100, and of a candidate of the search
FORGET = 0.6  # of the memory: after it a random history must no longer matter; one memory is scored
RANDOM_SHARE = 0.15  # of the training samples
LESS_FEEDBACK = 0.8  # factor of the weights on the model's output, repeated until it forgets
SAFELY = 0.5  # share of the limit to reach, because the final check draws other histories
MAX_FAIL = 8  # epochs in a row without a better free run


@dataclass(frozen=True, slots=True)
class Stage:
    """The course of one stage of the training."""

    name: str  # "horizon 1" is series-parallel, "less feedback" on many random histories
    scores: tuple[float, ...]  # free-run validation after every epoch, scaled units
    stop: str


@dataclass(slots=True)
class Trained:
    """The best weights of one start."""

    spec: Spec
    weights: FloatArray = field(default_factory=lambda: np.zeros(0))  # none before the training
    score: float = np.inf  # free-run validation, mean of the blocks' RMSE, scaled and weighted
    stages: list[Stage] = field(default_factory=list)
    members: int = 1  # trainings of a mean, which has no stages
    decay: float = 0.0  # this times every squared weight is added to the error, scaled units
    seed: int = 0  # of the first weights
    fold: int = 0  # whose validation blocks stopped it

    @property
    def cut_short(self) -> bool:
        """Whether the budget ended it before its last stage."""
        return not self.stages or self.stages[-1].stop == "budget"


def free_run(data: Prepared, spec: Spec, weights: FloatArray) -> FloatArray:
    """Return scaled free-run predictions (n,) of every whole segment; NaN before the first."""
    whole = [s for s in data.segments if s.stop - s.start > spec.memory]
    start = np.array([s.start + spec.memory for s in whole], dtype=np.int64)
    stop = np.array([s.stop for s in whole], dtype=np.int64)
    history = measured_history(data.samples, spec.lags, start)
    return simulate(spec, weights, u=data.samples.u, start=start, stop=stop, history=history)


def blocks_of(
    data: Prepared, spec: Spec, role: Role = Role.VALIDATE, memory: int = 0
) -> ClosedLoop:
    """Return the free run over every block of ``role``, begun up to 1,000 samples before it.

    memory : first samples of a segment that are not scored, at least the model's memory
    Raises RecordingError if no block is longer than the model's memory.
    """
    found = [
        (begin := max(low, first - HORIZONS[-1]), stop, first - begin)
        for low, first, stop in block_rows(data, max(spec.memory, memory), role)
    ]
    if not found:
        raise RecordingError(
            f"no block of {role.name.lower()} samples is longer than {spec.memory} lags"
        )
    start, stop, skip = (np.array(column, dtype=np.int64) for column in zip(*found, strict=True))
    history = measured_history(data.samples, spec.lags, start)
    return ClosedLoop(spec, data.samples, Pieces(start, stop, skip, history))


def block_rows(data: Prepared, memory: int, role: Role) -> Iterator[tuple[int, int, int]]:
    """Yield the row after ``memory`` samples of a segment, and the rows from there of every block.

    role : of the blocks; one without a valid output there is left out
    """
    for segment in data.segments:
        roles = data.role[segment.start : segment.stop]
        edges = segment.start + np.flatnonzero(np.diff(roles)) + 1
        for first, stop in pairwise([segment.start, *edges.tolist(), segment.stop]):
            low = segment.start + memory
            begin = max(first, low)
            if data.role[first] == role and data.samples.weight[begin:stop].any():
                yield low, begin, stop


def pieces(data: Prepared, spec: Spec, horizon: int, n_samples: int | None = None) -> Pieces:
    """Return the training blocks cut into stretches of at most ``horizon`` samples.

    n_samples : most samples, about; beyond, stretches are left out evenly
    """
    starts, stops = list[int](), list[int]()
    for _, first, stop in block_rows(data, spec.memory, Role.TRAIN):
        begin = np.arange(first, stop, horizon)
        starts += begin.tolist()
        stops += np.minimum(begin + horizon, stop).tolist()
    start, end = np.array(starts, dtype=np.int64), np.array(stops, dtype=np.int64)
    total = int((end - start).sum())
    if n_samples is not None and total > n_samples:
        count = max(1, int(len(start) * n_samples / total))
        keep = np.linspace(0, len(start) - 1, count).astype(np.int64)
        start, end = start[keep], end[keep]
    history = measured_history(data.samples, spec.lags, start)
    return Pieces(start, end, np.zeros_like(start), history)


def random_pieces(data: Prepared, spec: Spec, rng: np.random.Generator, n_samples: float) -> Pieces:
    """Return stretches of training samples from histories drawn evenly over the output's range.

    There are ``n_samples`` in all, none if a model need not forget its history. A stretch is scored
    from the sample on at which the history must be forgotten.
    """
    length, skip = max(1, round((1.0 + FORGET) * data.memory)), round(FORGET * data.memory)
    train = pieces(data, spec, length)
    whole = np.flatnonzero(train.stop - train.start == length)
    count = int(n_samples / length) if data.memory and len(whole) else 0
    start = train.start[rng.choice(whole, count)]
    history = any_histories(spec, count, rng)
    return Pieces(start, start + length, np.full_like(start, skip), history)


def train(
    data: Prepared,
    start: Trained,
    work: Work | None = None,
    horizons: tuple[int, ...] = HORIZONS,
    n_samples: int | None = None,
) -> Trained:
    """Return the best weights of one start by free-run validation on the way through ``horizons``.

    start : trained on from its weights; without weights it begins with random ones, series-parallel
    work : budget; when it is used up, no further epoch begins
    n_samples : most training samples, about; horizons below 100 take at most ``N_SAMPLES``,
        because they only prepare the longer ones
    """
    work, spec = work or Work(), start.spec
    rng = np.random.default_rng(start.seed)
    best = replace(start, stages=list(start.stages))
    if not len(start.weights):
        best.weights, horizons = initial_weights(spec, rng), (1, *horizons)
    weights = best.weights
    validation = blocks_of(data, spec)
    n_train = int((data.role == Role.TRAIN).sum())
    random = random_pieces(data, spec, rng, RANDOM_SHARE * min(n_train, n_samples or n_train))
    for horizon in horizons:
        early = N_SAMPLES if horizon < 100 else sys.maxsize
        cut = pieces(data, spec, horizon, min(early, n_samples or early))
        taken = cut + random if horizon > 1 else cut
        objective = ClosedLoop(spec, data.samples, taken, decay=start.decay)
        epoch = of_epoch(objective.n_samples, spec.n_weights)
        if not work.allows(epoch):
            if best.stages:
                best.stages[-1] = replace(best.stages[-1], stop="budget")
            break
        most = MAX_FAIL if horizon > 1 else EPOCHS
        outcome = _epochs(objective, weights, work, validation.score, most)
        best.stages.append(Stage(f"horizon {horizon}", tuple(outcome.scores), outcome.stop))
        if outcome.score < best.score:
            best.weights, best.score = outcome.weights, outcome.score
        weights = outcome.weights
    return best


def _epochs(
    objective: ClosedLoop,
    weights: FloatArray,
    work: Work,
    validate: Callable[[FloatArray], float] | None = None,
    max_fail: int = MAX_FAIL,
) -> LmOutcome:
    begins = partial(work.begins, of_epoch(objective.n_samples, len(weights)))
    return minimise(objective, weights, validate, begins, epochs=EPOCHS, max_fail=max_fail)


def finish(data: Prepared, trained: Trained, work: Work) -> Trained:
    """Return a training trained on with all samples; none is left that could stop it.

    Its score stays that of the blocks that it had not seen before.
    """
    whole, rng = data.training_on(*Role), np.random.default_rng(trained.seed)
    spec, n_samples = trained.spec, RANDOM_SHARE * len(data.role)
    cut = pieces(whole, spec, HORIZONS[-1]) + random_pieces(whole, spec, rng, n_samples)
    objective = ClosedLoop(spec, data.samples, cut, decay=trained.decay)
    outcome = _epochs(objective, trained.weights, work)
    if outcome.stop == "budget" and trained.stages:
        trained.stages[-1] = replace(trained.stages[-1], stop="budget")
    return replace(trained, weights=outcome.weights)


def with_less_feedback(data: Prepared, trained: Trained, seed: int, work: Work) -> Trained:
    """Return a training that remembers its history as one that forgets it.

    Its feedback is lessened until two histories are forgotten; from there it is trained on over
    many random histories, and the best weights that forget are kept.
    seed : of the histories, other ones than those of the final check
    """
    spec, weights = trained.spec, trained.weights.copy()

    def forgets(weights: FloatArray) -> bool:
        found = contraction(data, spec, weights, seed)
        return found.gap <= SAFELY * found.limit

    while not forgets(weights):
        layers(spec, weights)[0][0][:, -spec.lags :] *= LESS_FEEDBACK
        if spec.linear_path:
            linear_path(spec, weights)[-spec.lags :] *= LESS_FEEDBACK
    length = max(100, round((1.0 + FORGET) * data.memory))
    n_samples = int((data.role == Role.TRAIN).sum())
    many = random_pieces(data, spec, np.random.default_rng(seed), n_samples)
    cut = pieces(data, spec, length) + many
    objective = ClosedLoop(spec, data.samples, cut, decay=trained.decay)
    validation = blocks_of(data, spec)
    scored = lambda w: validation.score(w) if forgets(w) else np.inf  # noqa: E731
    outcome = _epochs(objective, weights, work, scored)
    stages = [*trained.stages, Stage("less feedback", tuple(outcome.scores), outcome.stop)]
    return replace(trained, weights=outcome.weights, score=outcome.score, stages=stages)
