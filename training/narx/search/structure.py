"""The search for memory, width and weight decay by trainings that leave out folds.

Every structure is trained on each fold and judged by its free run over the samples that it did not
see. From the best linear model and the best network the search goes to the neighbours, which differ
by one step in one number, until all of them are behind or the work is used up. The trainings of
structures that are not surely worse than the best go on with all samples of their folds.
Sources: Breiman, Friedman, Olshen and Stone, Classification and Regression Trees (1984), section
3.4.3 (the rule of one standard error); Krogh and Vedelsby, Neural network ensembles, cross
validation, and active learning, Advances in Neural Information Processing Systems 7 (1995).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any, Final

import numpy as np

from monitor.base.types import FloatArray
from training.narx.network import Spec
from training.narx.search.folds import FOLDS, longest_left_out
from training.narx.search.stages import HORIZONS, N_SAMPLES, Trained, blocks_of, train
from training.narx.work import Work
from training.recordings.samples.preparation import Prepared, Role

LADDERS: Final[dict[str, tuple[Any, ...]]] = {
    "longest": (1, 2, 3, 5, 8, 12, 20, 34, 60),
    "lags": (1, 2, 3, 5, 8, 12),
    "hidden": ((), (3,), (5,), (8,), (12,), (20,)),
    "decay": (1e-6, 1e-5, 1e-4, 1e-3, 1e-2),
}
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
        return Spec(
            len(data.inputs),
            self.lags,
            self.hidden,
            0,
            *data.scaling.y_scaled_limits,
            boxes(self.longest),
            linear_path=bool(self.hidden),
        )

    def neighbours(self) -> Iterator["Structure"]:
        """Yield the structures that differ by one step in one number."""
        for axis, ladder in LADDERS.items():
            at = ladder.index(getattr(self, axis))
            for step in (at - 1, at + 1):
                if 0 <= step < len(ladder) and (self.hidden or axis != "decay"):
                    yield replace(self, **{axis: ladder[step]})


@dataclass(frozen=True, slots=True)
class GivenShape:
    """The shape that a user asked for, without a linear path; it has no neighbours."""

    lags: int
    hidden: tuple[int, ...]
    input_lag_start: int
    decay: float = 1e-5

    def spec(self, data: Prepared) -> Spec:
        """Return the model's shape for ``data``."""
        size = self.lags, self.hidden, self.input_lag_start
        return Spec(len(data.inputs), *size, *data.scaling.y_scaled_limits)

    def neighbours(self) -> Iterator["GivenShape"]:
        """Yield nothing."""
        yield from ()


Shape = Structure | GivenShape


@dataclass(frozen=True, slots=True)
class Try:
    """One candidate, its trainings and their errors."""

    structure: Shape
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


class Search:
    """Candidates trained on the same folds.

    given : the only candidate; by default a search chooses
    starts : trainings that are wanted, at least; each structure is trained once on every fold, a
        given one as often as wanted
    """

    def __init__(
        self,
        folds: Sequence[Prepared],
        seed: int,
        threads: int = 2,
        tried: Callable[[Try], None] | None = None,
        given: GivenShape | None = None,
        starts: int = FOLDS,
    ) -> None:
        self.folds, self.seed, self.threads = folds, seed, threads
        self.tried, self.given, self.starts = tried, given, starts
        self.tries, self.members = dict[Shape, Try](), list[Trained]()
        self.count = max(len(folds), starts if given else 0)
        rows = [(f.role == Role.TRAIN) & (f.samples.weight > 0) for f in folds]
        self.n_train = min(int(each.sum()) for each in rows)
        longest = min(map(longest_left_out, folds))
        self.most_lags = int(
            min(self.n_train / SAMPLES_PER_LAG, longest / 2, LADDERS["longest"][-1])
        )

    @property
    def ranked(self) -> list[Try]:
        """Return the candidates, the best first."""
        return sorted(self.tries.values(), key=lambda t: t.rmse)

    def run(self, work: Work) -> None:
        """Try candidates until no neighbour of the best one is left, or the work is used up."""
        begin: list[Shape] = [self.given] if self.given else self._first()
        while begin and not work.is_over():
            self._try(begin, work)
            best = {bool(t.structure.hidden): t.structure for t in reversed(self.ranked)}
            near = [c for each in best.values() for c in each.neighbours()]
            begin = [c for c in near if c not in self.tries and self._possible(c)]

    def _first(self) -> list[Shape]:
        """Return linear models and networks of several memories, without any if none is possible.

        A dead time shows whole, or not at all.
        """
        first, ladder = Structure(), LADDERS["longest"]
        memories = ladder[ladder.index(first.longest) :: 2]
        begin = [
            replace(first, longest=longest, hidden=hidden)
            for hidden in (LADDERS["hidden"][0], first.hidden)
            for longest in memories
        ]
        return [c for c in begin if self._possible(c)] or [Structure(1, 1, ())]

    def _possible(self, structure: Shape) -> bool:
        spec = structure.spec(self.folds[0])
        return self.n_train >= SAMPLES_PER_WEIGHT * spec.n_weights and spec.memory <= self.most_lags

    def _try(self, candidates: Sequence[Shape], work: Work) -> None:
        """Train the candidates on every fold; one that the work cuts short is left out.

        The very first one counts all the same.
        """
        for structure in candidates:
            if self.tries and work.is_over():
                return
            parts = work.split(self.count)
            with ThreadPoolExecutor(self.threads) as pool:
                found = list(pool.map(partial(self._one, structure), range(self.count), parts))
            work.join(parts)
            if self.tries and any(part.is_over() for part in parts):
                work.is_used_up = True
                return
            self.tries[structure] = done = self._judged(structure, found)
            if self.tried:
                self.tried(done)

    def _one(self, structure: Shape, number: int, work: Work) -> Trained:
        fold, most = number % len(self.folds), N_SAMPLES // len(self.folds)
        data, decay = self.folds[fold], structure.decay if structure.hidden else 0.0
        start = Trained(structure.spec(data), decay=decay, seed=self.seed + number, fold=fold)
        return train(data, start, work, n_samples=most)

    def _judged(self, structure: Shape, trained: Sequence[Trained]) -> Try:
        longest = max(self.most_lags, trained[0].spec.memory)
        scored = [blocks_of(self.folds[t.fold], t.spec, Role.TEST, longest) for t in trained]
        errors = [each.errors(t.weights) for each, t in zip(scored, trained, strict=True)]
        weights = np.concatenate([each.weights for each in scored])
        shares = weights / weights.sum()
        return Try(structure, tuple(trained), np.concatenate(errors), shares)

    def train_members(self, work: Work) -> None:
        """Train the best structures' trainings on with all samples of their folds."""
        good = [each for each in self.ranked if not each.surely_behind(self.ranked[0])]
        begun = [t for each in good[: -(-self.starts // self.count)] for t in each.trained]
        self.members = self._trained_on(begun, self.folds, work, HORIZONS[1:])

    def refitted(self, everything: Prepared, work: Work, count: int) -> list[Trained]:
        """Return the first ``count`` members after more epochs with all samples."""
        every = [everything] * len(self.folds)
        return self._trained_on(self.members[:count], every, work, HORIZONS[-1:])

    def _trained_on(
        self,
        begun: Sequence[Trained],
        data: Sequence[Prepared],
        work: Work,
        horizons: tuple[int, ...],
    ) -> list[Trained]:
        """Return the trainings after more epochs with the data of their folds."""
        parts = work.split(len(begun))

        def one(start: Trained, part: Work) -> Trained:
            return train(data[start.fold], start, part, horizons)

        with ThreadPoolExecutor(self.threads) as pool:
            found = list(pool.map(one, begun, parts))
        work.join(parts)
        return found
