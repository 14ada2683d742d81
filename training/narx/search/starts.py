"""Trainings from several random starts, their committees, and the choice of one of them."""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from monitor.base.types import FloatArray
from training.narx.network import Spec, layers, linear_path
from training.narx.search.stability import Contraction, contraction
from training.narx.search.stages import Trained, blocks_of, free_run_score, train
from training.narx.search.structure import SURE
from training.narx.work import Work
from training.recordings.samples.preparation import Prepared

MOST_MEMBERS = 3  # of a committee
FURTHER_STARTS = 3  # at most, where no start forgets how it began

Shape = tuple[Spec, float]  # with the decay of its weights


@dataclass(frozen=True, slots=True)
class Starts:
    """Trainings on the same data from different random weights, side by side in threads."""

    folds: Sequence[Prepared]  # the same data, each with other validation blocks
    seed: int
    work: Work
    threads: int
    progress: Callable[[int, int, int, float], None] | None = None  # as in ``fit``

    @property
    def data(self) -> Prepared:
        """Return the first fold."""
        return self.folds[0]

    def train(self, jobs: Sequence[tuple[int, Shape]], before: int = 0) -> tuple[Trained, ...]:
        """Return the trainings; each of them gets an equal part of the work left.

        jobs : number of the random start, and shape
        before : trainings that are done already, for the progress
        """
        workers = max(1, min(self.threads, len(jobs)))
        parts = self.work.split(len(jobs))
        progress = self.progress

        def one(number: int) -> Trained:
            start, (spec, decay) = jobs[number]
            told = (lambda h, e, s: progress(before + number, h, e, s)) if progress else None
            seed = self.seed + 1000 * start
            fold = start % len(self.folds)
            trained = train(self.folds[fold], spec, seed, parts[number], told, decay=decay)
            return replace(trained, fold=fold)

        with ThreadPoolExecutor(workers) as pool:
            trained = tuple(pool.map(one, range(len(jobs))))
        self.work.join(parts)
        return trained

    def until_one_forgets(
        self, trained: tuple[Trained, ...], shape: Shape, first: int
    ) -> tuple[tuple[Trained, ...], int, Contraction]:
        """Return the trainings with the further starts that were needed, and ``choose`` of them.

        first : number of the first further start
        A start is begun only if as much work is left as a training took.
        """
        each = self.work.spent / max(first, 1)
        best, gap = choose(self.data, trained, self.seed)
        for start in range(first, first + FURTHER_STARTS):
            forgets = gap.gap <= gap.limit
            if not self.data.memory or forgets or self.work.left < each or self.work.is_over():
                break
            trained += self.train([(start, shape)], before=len(trained))
            best, gap = choose(self.data, trained, self.seed)
        return trained, best, gap


def choose(data: Prepared, trained: Sequence[Trained], seed: int) -> tuple[int, Contraction]:
    """Return the number of the best training and how well it forgets its history.

    If the data have a memory, a network that forgets its history comes before one that does not. A
    committee comes before the best start unless the held-out blocks are sure that it is worse: they
    are of the same drives, and on others the mean errs less. A linear model comes before all if it
    follows the blocks better, and does not remember what such a network forgets.
    """
    gaps = [contraction(data, t.spec, t.weights, seed) for t in trained]
    late = [bool(data.memory) and not gap.gap <= gap.limit for gap in gaps]
    networks = [i for i, each in enumerate(trained) if each.spec.hidden]
    first = min(networks, key=lambda i: (late[i], trained[i].score), default=None)
    if first is not None:
        alike = [i for i in networks if late[i] == late[first]]
        first = _largest(data, trained, alike, first)
    forgets = first is not None and np.isfinite(trained[first].score) and not late[first]
    linear = [
        i for i, each in enumerate(trained) if not each.spec.hidden and not (forgets and late[i])
    ]
    best = min([*linear, *([] if first is None else [first])], key=lambda i: trained[i].score)
    return best, gaps[best]


def _largest(data: Prepared, trained: Sequence[Trained], alike: Sequence[int], first: int) -> int:
    """Return the largest committee within a standard error of the first network, else the first.

    Source: Breiman, Friedman, Olshen and Stone, Classification and Regression Trees (1984),
    section 3.4.3 (the rule of one standard error).
    """
    best = trained[first]
    for i in sorted(alike, key=lambda i: (-trained[i].members, trained[i].score)):
        each = trained[i]
        if each.members > best.members and not _surely_worse(data, each, best):
            return i
    return first


def _surely_worse(data: Prepared, one: Trained, other: Trained) -> bool:
    """Whether one has larger errors in the validation blocks, by more than a standard error."""
    memory = max(one.spec.memory, other.spec.memory)
    blocks = [blocks_of(data, each.spec, memory=memory) for each in (one, other)]
    shares = blocks[0].weights / blocks[0].total_weight
    losses = blocks[0].errors(one.weights) - blocks[1].errors(other.weights)
    loss = float(shares @ losses)
    spread = float(shares @ (losses - loss) ** 2)
    return not loss <= SURE * math.sqrt(spread * float(shares @ shares))


def committees(data: Prepared, trained: Sequence[Trained]) -> tuple[Trained, ...]:
    """Return the committees of the two and three best trainings of each shape."""
    found = []
    for spec in dict.fromkeys(t.spec for t in trained if t.spec.hidden):
        same = [t for t in trained if t.spec == spec and np.isfinite(t.score)]
        same.sort(key=lambda t: t.score)
        for count in range(2, min(len(same), MOST_MEMBERS) + 1):
            wide, weights = committee(spec, [t.weights for t in same[:count]])
            score = free_run_score(data, wide, weights)
            found.append(Trained(wide, weights, score, members=count))
    return tuple(found)


def means(folds: Sequence[Prepared], trained: Sequence[Trained], seed: int) -> tuple[Trained, ...]:
    """Return, for each shape, the mean of the best training of every fold.

    A training that forgets its history comes before one that does not. The score is the mean of
    the members' scores, each on blocks that it did not see.
    """
    found = []
    for spec, decay in dict.fromkeys((t.spec, t.decay) for t in trained):
        same = [t for t in trained if (t.spec, t.decay) == (spec, decay) and np.isfinite(t.score)]
        own = [[t for t in same if t.fold == fold] for fold in range(len(folds))]
        best = [each[choose(folds[0], each, seed)[0]] for each in own if each]
        if len(best) > 1:
            wide, weights = committee(spec, [t.weights for t in best])
            score = float(np.mean([t.score for t in best]))
            found.append(Trained(wide, weights, score, members=len(best), decay=decay))
    return tuple(found)


def committee(spec: Spec, members: Sequence[FloatArray]) -> tuple[Spec, FloatArray]:
    """Return shape and weights of the mean of several trainings of one shape.

    members : weights (n_weights,) of the shape ``spec``
    They stand side by side in wider layers that are block-diagonal, so the mean is a NARX like any
    other, and it feeds back the mean. Errors of members that differ by their random start alone
    partly cancel.
    Source: Perrone and Cooper, When networks disagree: ensemble methods for hybrid neural networks
    (1993); the shared feedback is our own choice, because it keeps one state.
    Raises ValueError if there is no member.
    """
    if not members:
        raise ValueError("a committee needs members")
    count = len(members)
    stacks = [layers(spec, weights) for weights in members]
    parts: list[FloatArray] = []
    for depth in range(len(spec.hidden) + 1):
        matrices = [stack[depth][0] for stack in stacks]
        biases = [stack[depth][1] for stack in stacks]
        if depth == len(spec.hidden):  # the mean; without hidden layers of the same regressor
            joined = np.concatenate(matrices, axis=1) / count if depth else sum(matrices) / count
            bias = np.mean(biases, axis=0)
        else:
            joined = block_diag(*matrices) if depth else np.concatenate(matrices)
            bias = np.concatenate(biases)
        parts += [np.ravel(joined), bias]
    if spec.linear_path:
        parts.append(np.mean([linear_path(spec, weights) for weights in members], axis=0))
    wide = replace(spec, hidden=tuple(n * count for n in spec.hidden))
    return wide, np.concatenate(parts)
