"""One recording as arrays: its driving cycles and conditions, and what then happens, in order."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import pairwise
from operator import itemgetter

import numpy as np

from monitor.base.config import Config
from monitor.base.runs import runs, since, stretches
from monitor.base.types import BoolArray, FloatArray, IntArray, SampleBlock
from monitor.grid.block_samples import Clearing
from monitor.judge import enable
from monitor.judge.enable import Enable
from monitor.judge.plausibility import ActivityTest, Plausibility, TickResult, TickResults
from monitor.judge.window import Window
from monitor.memory.block_cycles import BlockCycles
from monitor.model.card import ModelCard
from monitor.pipeline.course import Course
from monitor.pipeline.stream import BURNING

_INPUTS_VALID = enable.CONDITIONS.index("inputs_valid")
# what happens at one sample, in this order; the three tests on samples stand at TICK and behind it
_CLEARED, _COUNTED, _BEGUN, _TICK, _ACTIVITY, _WINDOW = 0, 1, 2, 3, 6, 7

Happening = tuple[int, int, Callable[[Course], None]]  # sample, place within it, and what then


class Reader:
    """What turns recordings with the same signals into arrays."""

    def __init__(self, names: Sequence[str], card: ModelCard, config: Config) -> None:
        output, plausibility = card.output, config.plausibility
        self.names, self.config = names, config
        self.period_s = card.period_ns * 1e-9
        self.inputs = [names.index(name) for name in card.input_names]
        self.output = names.index(output.name)
        self.cycles = BlockCycles(
            config.cycles, config.profile, names, output.name, plausibility.engine_running_rpm
        )
        self.conditions = Enable.of(config.enable, names, card).block
        self.tests = Plausibility(plausibility, names, output.name, self.period_s)
        self.activity = ActivityTest.of(plausibility, output, names, self.period_s)


class Recording:
    """One recording; the model's predictions and the bank's readings are filled in."""

    def __init__(self, block: SampleBlock, reader: Reader) -> None:
        self.block, self._reader = block, reader
        self._moments = reader.cycles.moments(block)
        begins = [k for k, what in self._moments if what == "driving_cycle"]
        self.cuts = [0, *begins, len(block.t_ns)]  # where driving cycles begin, and the end
        self.conditions: BoolArray = np.concatenate(
            [reader.conditions(block.values[a:b]) for a, b in pairwise(self.cuts)]
        )
        self.inputs = block.values[:, reader.inputs].astype(np.float32)
        self.measured: FloatArray = block.values[:, reader.output].copy()
        self.predicted: FloatArray = np.full(len(block.t_ns), np.nan)
        self.banks: dict[int, FloatArray] = {}  # what the bank reads in the window that begins

    def segments(self) -> list[tuple[int, int]]:
        """Return (begin, end) of each run of samples with valid inputs in one driving cycle."""
        valid = self.conditions[:, _INPUTS_VALID]
        return [
            (a + begin, a + end) for a, b in pairwise(self.cuts) for begin, end in runs(valid[a:b])
        ]

    def windows(self, begin: int, end: int) -> IntArray:
        """Return where windows begin in a segment that has its predictions, counted from it."""
        return stretches(self._usable(begin, end), self._reader.config.window.n_samples)

    def interrupted(self) -> int:
        """Return how many windows were begun and discarded."""
        n, found = self._reader.config.window.n_samples, 0
        for a, b in pairwise(self.cuts):
            lengths = [(e - s) % n for s, e in runs(self._usable(a, b)) if a + e < self.cuts[-1]]
            found += sum(length > 0 for length in lengths)
        return found

    def _usable(self, begin: int, end: int) -> BoolArray:
        """Return which samples fill windows."""
        usable = self.conditions[begin:end].all(axis=1)
        return np.asarray(usable & ~np.isnan(self.predicted[begin:end]))

    def happenings(
        self,
        clearings: Sequence[Clearing],
        ticks_to_mature: tuple[int, int],
        *,
        keep_banks: bool,
    ) -> list[Happening]:
        """Return what happens, in the order of time; the bank's readings go with it.

        ticks_to_mature : so many failed, and passed, results in a row mature
        """
        found = [*self._counted(clearings), *self._judged(clearings, keep_banks=keep_banks)]
        for a, b in pairwise(self.cuts):
            found += self._ticks(a, b, clearings, ticks_to_mature)
        return sorted(found, key=itemgetter(0, 1))

    def _counted(self, clearings: Sequence[Clearing]) -> Iterator[Happening]:
        for k, t_ns in clearings:
            yield k, _CLEARED, partial(Course.clear, t_ns=t_ns)
        for k, moment in self._moments:
            yield k, _COUNTED, partial(Course.count, moment=moment, k=k)

    def _ticks(
        self, a: int, b: int, clearings: Sequence[Clearing], ticks_to_mature: tuple[int, int]
    ) -> Iterator[Happening]:
        """Yield what the tests that need no model find in one driving cycle."""
        reader, values = self._reader, self.block.values[a:b]
        anew = [each.n_samples - a for each in clearings]
        for place, results in enumerate(reader.tests.block(values, self.block.quality[a:b])):
            for k, result in _maturing(results, anew, *ticks_to_mature):
                yield a + k, _TICK + place, partial(Course.matured, result=result, k=a + k)
        active = reader.tests.running(values)
        for condition in BURNING:
            active &= self.conditions[a:b, condition]
        for k, failed, fault in reader.activity.block(self.measured[a:b], active):
            happen = partial(Course.activity, failed=failed, fault=fault, k=a + k)
            yield a + k, _ACTIVITY, happen

    def _judged(self, clearings: Sequence[Clearing], *, keep_banks: bool) -> Iterator[Happening]:
        """Yield the windows, and where decisions begin anew which of them come until then."""
        n = self._reader.config.window.n_samples
        windows = list(self._windows(keep_banks=True))
        kept = windows if keep_banks else list(self._windows(keep_banks=False))
        last = np.array(sorted(self.banks), dtype=np.int64) + n - 1
        self.banks.clear()
        begins = {*self.cuts[:-1], *(k for k, _ in clearings if k < len(self.block.t_ns))}
        for a, b in pairwise([*sorted(begins), len(self.block.t_ns)]):
            own = slice(*np.searchsorted(last, (a, b)).tolist())
            yield a, _BEGUN, partial(Course.begin, windows=windows[own])
            for k, window in zip(last[own].tolist(), kept[own], strict=True):
                yield k, _WINDOW, partial(Course.window, window=window, k=k)

    def _windows(self, *, keep_banks: bool) -> Iterator[Window]:
        t_ns, n = self.block.t_ns, self._reader.config.window.n_samples
        none = np.empty((n, 0))
        for index, begin in enumerate(sorted(self.banks)):
            inside = slice(begin, begin + n)
            yield Window(
                index,
                int(t_ns[begin]),
                int(t_ns[begin + n - 1]),
                self.measured[inside].copy(),
                self.predicted[inside].copy(),
                self.banks[begin] if keep_banks else none,
            )


def _maturing(
    results: TickResults, anew: Sequence[int], failed_count: int, passed_count: int
) -> Iterator[tuple[int, TickResult]]:
    """Yield sample and result where so many alike results in a row mature.

    anew : samples from which on a row begins anew
    """
    changed = np.diff(results.failed, prepend=~results.failed[:1])
    places = np.searchsorted(results.at, anew)
    changed[places[places < len(changed)]] = True
    matures = since(changed) == np.where(results.failed, failed_count, passed_count) - 1
    for k, kind in zip(results.at[matures].tolist(), results.kind[matures].tolist(), strict=True):
        yield k, results.kinds[kind]
