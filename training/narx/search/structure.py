"""The choice of memory and size: a walk over structures, judged by free run on held-out blocks.

The walk begins at a middle structure. It goes along one axis after another (longest input lag,
output lags, hidden layers, weight decay) to the best neighbour, until no axis improves or the time
is up. Every candidate gets a short closed-loop training on a part of the samples. A larger
structure must be better by more than the uncertainty over the blocks, a smaller one must only not
be worse. So the smaller one wins where a network would overfit a short record. On short recordings
several choices of held-out blocks judge a candidate.
"""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from monitor.base.types import FloatArray
from training.narx.network import Spec
from training.narx.search.stages import blocks_of, train
from training.narx.work import Work
from training.recordings.samples.preparation import Prepared, Role

LONGEST = (1, 2, 3, 5, 8, 12, 20, 34, 60)  # input lags
LAGS = (1, 2, 3, 5, 8, 12)  # output lags
HIDDEN: tuple[tuple[int, ...], ...] = ((), (3,), (5,), (8,), (12,), (8, 8), (12, 12), (20, 12))
DECAY = (0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)  # of the weights
FIRST = (5, 3, (8,))
FIRST_DECAY = (1e-5, 1e-4)  # on long and on short recordings
FAR = (34, 12, 60)  # input lags that are tried before the walk
SINGLE_LAGS = 8  # boxes are single lags up to here, then they widen
WIDENING = 1.35
HORIZONS, EPOCHS = (20, 100), {1: 20, 20: 10, 100: 15}  # a short training
N_SAMPLES = 25_000
SEEDS_SHORT = 2  # trainings of a candidate on every choice of blocks of a short recording
SAMPLES_PER_WEIGHT = 2.0  # below this a candidate is not tried
SAMPLES_PER_LAG = 20
WALKS = 2  # from the best memories among the first tries
MISSES = 2  # steps without improvement before the walk turns round
LEAST_GAIN = 0.01  # of the RMSE; differences below it are no reason for more weights
SURE = 1.0  # standard errors by which a larger structure must be better


@dataclass(frozen=True, slots=True)
class Structure:
    """Memory and size of a NARX with a linear path."""

    longest: int  # input lag
    lags: int  # of the output
    hidden: tuple[int, ...]
    decay: float = 0.0  # of the weights, see ``ClosedLoop``

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


@dataclass(frozen=True, slots=True)
class Try:
    """One candidate and its errors."""

    structure: Structure
    n_weights: int
    errors: FloatArray  # (n_blocks,) free-run RMSE of held-out blocks, scaled units
    shares: FloatArray  # (n_blocks,) of the samples, sum 1

    @property
    def rmse(self) -> float:
        """Mean of the blocks' free-run RMSE, scaled units."""
        return float(self.shares @ self.errors)


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
    """Candidates on the same data, held-out blocks different in each of the ``rotations``."""

    def __init__(
        self,
        rotations: Sequence[Prepared],
        work: Work,
        threads: int = 2,
        progress: Callable[[Try], None] | None = None,
    ) -> None:
        self.rotations, self.work, self.progress = rotations, work, progress
        self.threads = threads
        self.tries: dict[Structure, Try] = {}
        data = rotations[0]
        self.n_train = int(((data.role == Role.TRAIN) & (data.samples.weight > 0)).sum())
        longest = max(s.stop - s.start for s in data.segments)
        self.most_lags = int(min(self.n_train / SAMPLES_PER_LAG, longest / 2, max(LONGEST)))

    def run(self) -> list[Structure]:
        """Return the ends of the walks, the best first; a walk begins at each of two memories."""
        first = self._first()
        self._try([first])
        for longest in FAR:  # a long dead time shows only if the lags cover all of it
            if not self._late():
                self._try([c for c in [replace(first, longest=longest)] if self._possible(c)])
        begins = sorted(self.tries.values(), key=lambda t: t.rmse)[:WALKS]
        ends = [self._hill(begin.structure) for begin in begins if not self._late()]
        best = min(ends or [begins[0].structure], key=lambda c: self.tries[c].rmse)
        return [best, *(c for c in dict.fromkeys(ends) if c != best)]

    def _hill(self, best: Structure) -> Structure:
        while True:
            before = best
            best = self._walk(best, "longest", LONGEST)
            best = self._walk(best, "lags", LAGS)
            best = self._walk(best, "hidden", HIDDEN)
            if best.hidden:
                best = self._walk(best, "decay", DECAY)
            if best == before or self._late():
                return best

    def _late(self) -> bool:
        return self.work.is_over()

    def _first(self) -> Structure:
        """Return the middle structure, or the largest below it that the samples allow."""
        best = Structure(*FIRST, FIRST_DECAY[len(self.rotations) > 1])
        while not self._possible(best) and best.hidden:
            best = replace(best, hidden=HIDDEN[HIDDEN.index(best.hidden) - 1])
        while not self._possible(best) and best.longest > LONGEST[0]:
            best = replace(best, longest=LONGEST[LONGEST.index(best.longest) - 1])
        return best

    def _possible(self, structure: Structure) -> bool:
        spec = structure.spec(self.rotations[0])
        return self.n_train >= SAMPLES_PER_WEIGHT * spec.n_weights and spec.memory <= self.most_lags

    def _walk(self, best: Structure, axis: str, ladder: Sequence[Any]) -> Structure:
        """Return the best structure along one axis, looking up and down the ladder."""
        middle = ladder.index(getattr(best, axis))
        ahead = {1: list(ladder[middle + 1 :]), -1: list(ladder[:middle])[::-1]}
        misses = {1: 0, -1: 0}
        while not self._late():
            steps = [d for d in (1, -1) if ahead[d] and misses[d] < MISSES]
            found = {d: replace(best, **{axis: ahead[d].pop(0)}) for d in steps}
            found = {d: c for d, c in found.items() if self._possible(c)}
            if not found:
                break
            self._try(list(found.values()))
            for direction, candidate in found.items():
                if candidate not in self.tries:
                    continue
                if self._better(self.tries[candidate], self.tries[best]):
                    best, misses[direction] = candidate, 0
                    ahead[-direction] = []
                else:
                    misses[direction] += 1
        return best

    def _better(self, candidate: Try, best: Try) -> bool:
        gains = best.errors - candidate.errors
        gain = float(best.shares @ gains)
        spread = float(best.shares @ (gains - gain) ** 2)
        error = math.sqrt(spread * float(best.shares @ best.shares))
        freer = candidate.structure.decay < best.structure.decay
        if candidate.n_weights > best.n_weights or freer:
            return gain > max(LEAST_GAIN * best.rmse, SURE * error)
        return gain > -min(LEAST_GAIN * best.rmse, SURE * error)

    def _try(self, candidates: Sequence[Structure]) -> None:
        """Train the candidates that are new; the first of all is tried however late it is."""
        new = [c for c in candidates if c not in self.tries]
        seeds = range(SEEDS_SHORT if len(self.rotations) > 1 else 1)
        jobs = [(c, data, seed) for c in new for data in self.rotations for seed in seeds]
        with ThreadPoolExecutor(self.threads) as pool:
            results = list(pool.map(lambda job: self._short_training(*job), jobs))
        self.work.join([part for *_, part in results])
        n = len(self.rotations) * len(seeds)
        for i, candidate in enumerate(new):
            parts = results[i * n : (i + 1) * n]
            weights = np.concatenate([w for _, w, _ in parts])
            self.tries[candidate] = done = Try(
                candidate,
                candidate.spec(self.rotations[0]).n_weights,
                np.concatenate([errors for errors, _, _ in parts]),
                weights / weights.sum(),
            )
            if self.progress:
                self.progress(done)

    def _short_training(
        self, structure: Structure, data: Prepared, seed: int
    ) -> tuple[FloatArray, FloatArray, Work]:
        spec, work = structure.spec(data), Work()
        trained = train(
            data,
            spec,
            seed=seed,
            work=work,
            progress=None,
            horizons=HORIZONS,
            epochs=EPOCHS,
            n_samples=N_SAMPLES,
            decay=structure.decay,
        )
        held_out = blocks_of(data, spec, memory=max(self.most_lags, spec.memory))
        return held_out.errors(trained.weights), held_out.weights, work
