"""The search for memory, width and weight decay, and the mean of its best trainings.

Every structure is trained on some folds of the samples and judged by its free run over the blocks
that it did not see. From the best one the search goes to its neighbours, which differ by one step
in one number, until all of them are behind it or the work is used up. The trainings of the best
structures are trained on, one in each fold, and end on all samples; the model is their mean.
Sources: Breiman, Friedman, Olshen and Stone, Classification and Regression Trees (1984), section
3.4.3 (the rule of one standard error); Krogh and Vedelsby, Neural network ensembles, cross
validation, and active learning, Advances in Neural Information Processing Systems 7 (1995).
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import Any, Final

import numpy as np

from monitor.base.types import FloatArray
from training.narx.network import Spec
from training.narx.search import stages
from training.narx.search.stages import N_SAMPLES, Trained, train
from training.narx.work import Work
from training.recordings.samples.preparation import Prepared, Role

LADDERS: Final[dict[str, tuple[Any, ...]]] = {
    "longest": (1, 2, 3, 5, 8, 12, 20, 34, 60),
    "lags": (1, 2, 3, 5, 8, 12),
    "hidden": ((), (3,), (5,), (8,), (12,), (20,)),
    "decay": (1e-6, 1e-5, 1e-4, 1e-3, 1e-2),
}
FOLDS: Final = 4  # at most, and members of the mean, about
STARTS: Final = 3  # of a shape that is given, and of a twin
SINGLE_LAGS: Final = 8  # boxes are single lags up to here, then they widen
WIDENING: Final = 1.35
SAMPLES_PER_WEIGHT: Final = 2.0  # below this a candidate is not tried
SAMPLES_PER_LAG: Final = 20


@dataclass(frozen=True, slots=True)
class Structure:
    """Memory and size of a NARX with a linear path."""

    longest: int = 5  # input lag
    lags: int = 3  # of the output
    hidden: tuple[int, ...] = (8,)
    decay: float = 1e-4  # of the weights, see ``ClosedLoop``

    def spec(self, data: Prepared) -> Spec:
        """Return the model's shape for ``data``."""
        size = (len(data.inputs), self.lags, self.hidden, 0, *data.scaling.y_scaled_limits)
        return Spec(*size, boxes(self.longest), linear_path=bool(self.hidden))

    def neighbours(self) -> Iterator["Structure"]:
        """Yield the structures that differ by one step in one number."""
        for axis, ladder in LADDERS.items():
            at = ladder.index(getattr(self, axis))
            for step in (at - 1, at + 1):
                if 0 <= step < len(ladder) and (self.hidden or axis != "decay"):
                    yield replace(self, **{axis: ladder[step]})


@dataclass(frozen=True, slots=True)
class Try:
    """One candidate, its trainings and their errors."""

    structure: Structure
    trained: tuple[Trained, ...]
    errors: FloatArray  # (n_blocks,) free-run RMSE of held-out blocks, scaled units
    shares: FloatArray  # (n_blocks,) of the samples, sum 1

    @property
    def n_weights(self) -> int:
        """Number of weights."""
        return self.trained[0].spec.n_weights

    @property
    def rmse(self) -> float:
        """Mean of the blocks' free-run RMSE, scaled units."""
        return float(self.shares @ self.errors)

    def surely_behind(self, best: "Try") -> bool:
        """Whether its errors are larger by more than a standard error over the blocks."""
        losses = self.errors - best.errors
        loss = float(self.shares @ losses)
        spread = float(self.shares @ (losses - loss) ** 2)
        return not loss <= math.sqrt(spread * float(self.shares @ self.shares))


def boxes(longest: int) -> tuple[tuple[int, int], ...]:
    """Return boxes over lags 0 .. longest: single lags first, each later one 1.35 times as old.

    >>> boxes(15)[-3:]
    ((8, 9), (9, 12), (12, 16))
    """
    edges = [0]
    while edges[-1] <= longest:
        step = round((WIDENING - 1) * edges[-1]) if edges[-1] > SINGLE_LAGS else 1
        edges.append(min(edges[-1] + max(1, step), longest + 1))
    return tuple(pairwise(edges))


@dataclass
class Search:
    """Candidates on the same data, held-out blocks different in each of the ``folds``."""

    folds: Sequence[Prepared]
    most_tried: int  # folds on which a candidate is tried; members are trained on all
    seed: int
    work: Work
    threads: int = 2
    tried: Callable[[Try], None] | None = None
    tries: dict[Structure, Try] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.n_tried = min(self.most_tried, len(self.folds))
        self.n_train = self.folds[0].n_train
        half = max(s.stop - s.start for s in self.folds[0].segments) / 2
        self.most_lags = int(min(self.n_train / SAMPLES_PER_LAG, half, LADDERS["longest"][-1]))

    @property
    def ranked(self) -> list[Try]:
        """Return the candidates, the best first."""
        return sorted(self.tries.values(), key=lambda t: t.rmse)

    def run(self) -> None:
        """Try candidates until no neighbour of the best one is left, or the work is used up."""
        first, ladder = Structure(), LADDERS["longest"]  # a dead time shows whole, or not at all
        begin = [replace(first, longest=n) for n in ladder[ladder.index(first.longest) :: 2]]
        begin = [c for c in begin if self._possible(c)] or [Structure(1, 1, ())]
        while begin and not (self.tries and self.work.is_over()):
            self._try(begin)
            near = self.ranked[0].structure.neighbours()
            begin = [c for c in near if c not in self.tries and self._possible(c)]

    def _possible(self, structure: Structure) -> bool:
        spec = structure.spec(self.folds[0])
        return self.n_train >= SAMPLES_PER_WEIGHT * spec.n_weights and spec.memory <= self.most_lags

    def _try(self, candidates: Sequence[Structure]) -> None:
        """Train the candidates on every fold; one that the work cuts short is left out.

        The very first one counts all the same.
        """
        for structure in candidates:
            if self.tries and self.work.is_over():
                return
            short = partial(self._short, structure)
            found = self.work.side_by_side(short, range(self.n_tried), self.threads)
            if self.tries and any(trained.cut_short for trained in found):
                self.work.is_used_up = True
                return
            self.tries[structure] = done = self._judged(structure, found)
            if self.tried:
                self.tried(done)

    def _short(self, structure: Structure, fold: int, work: Work) -> Trained:
        data, decay = self.folds[fold], structure.decay if structure.hidden else 0.0
        start = Trained(structure.spec(data), decay=decay, seed=self.seed + fold, fold=fold)
        most = N_SAMPLES // self.n_tried
        return train(data, start, work, horizons=stages.HORIZONS[:-1], n_samples=most)

    def _judged(self, structure: Structure, trained: Sequence[Trained]) -> Try:
        longest = max(self.most_lags, trained[0].spec.memory)
        scored = [stages.blocks_of(self.folds[t.fold], t.spec, memory=longest) for t in trained]
        errors = [each.errors(t.weights) for each, t in zip(scored, trained, strict=True)]
        weights = np.concatenate([each.weights for each in scored])
        shares = weights / weights.sum()
        return Try(structure, tuple(trained), np.concatenate(errors), shares)

    def members(self, keep: bool, work: Work, count: int = FOLDS) -> list[Trained]:
        """Return at most ``count`` trainings of the best structures, ended on all samples.

        keep : only train on what the first fold does not hold out
        """
        good = [each for each in self.ranked if not each.surely_behind(self.ranked[0])]
        free = 1 if keep else len(self.folds)
        each = min(free, self.n_tried)
        begun = list(dict.fromkeys((i // each % len(good), i % free) for i in range(count)))

        def one(place: tuple[int, int], part: Work) -> Trained:
            known, fold = good[place[0]], place[1]
            tried = known.trained[fold : fold + 1] or [self._short(known.structure, fold, part)]
            done = train(self.folds[fold], tried[0], part, stages.HORIZONS[1:])
            return done if keep else stages.finish(self.folds[fold], done, part)

        return work.side_by_side(one, begun, self.threads)


def folds_of(data: Prepared, others: Iterable[Prepared]) -> list[Prepared]:
    """Return the data, and again with the validation blocks of each of the others.

    others : the same samples with other blocks held out
    """
    folds, scored = [data], _scored(data)
    for other in others:
        held_out = np.where(other.role == Role.VALIDATE, other.role, np.int8(Role.TRAIN))
        fold = replace(data, role=np.where(data.role == Role.TEST, data.role, held_out))
        if scored and 2 * _scored(fold) >= scored:  # the test may leave nothing of other blocks
            folds.append(fold)
    return folds


def _scored(data: Prepared) -> int:
    """Return the validation samples that even the longest memory lets score."""
    blocks = stages.block_rows(data, LADDERS["longest"][-1], Role.VALIDATE)
    return sum(int((data.samples.weight[first:stop] > 0.0).sum()) for _, first, stop in blocks)
