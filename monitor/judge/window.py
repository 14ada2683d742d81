"""Windows of consecutive enabled samples, and what a rule says after one."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from monitor.base.runs import runs
from monitor.base.types import BoolArray, FloatArray, IntArray

Outcome = Literal["passed", "failed", "inconclusive"]


@dataclass(frozen=True, slots=True)
class Opinion:
    """The finding of a rule on all windows so far."""

    outcome: Outcome
    fault: str | None = None  # one of the rule's, if failed
    also: tuple[str, ...] = ()  # others of its faults that explain as much


@dataclass(frozen=True, slots=True)
class Window:
    """A full window; nothing writes to its arrays any more."""

    index: int
    t_start_ns: int  # of its first sample
    t_end_ns: int  # of its last sample
    measured: FloatArray  # (n,) output's unit
    predicted: FloatArray  # (n,) output's unit
    bank: FloatArray  # (n, n_hypotheses), oriented like phi
    is_cut: bool = False  # around a fuel cut, by which alone its samples are not enabled

    @property
    def residual(self) -> FloatArray:
        """Return measured minus predicted, (n,)."""
        return self.measured - self.predicted


class Span(NamedTuple):
    """Samples begin to end of a block that fill windows, and the bank's readings in them."""

    begin: int
    end: int
    read: FloatArray  # (end - begin, n_hypotheses)


class Series(NamedTuple):
    """The samples of a block, as far as windows need them."""

    t_ns: IntArray  # (n,)
    measured: FloatArray  # (n,) output's unit
    predicted: FloatArray  # (n,) output's unit


class Windows:
    """Fills windows that do not overlap; an interruption discards the window begun."""

    def __init__(self, n_samples: int, n_hypotheses: int, *, is_cut: bool = False) -> None:
        self._n, self._is_cut = n_samples, is_cut
        self._shape = n_samples, n_hypotheses
        self._filled = 0  # samples of the window begun
        self._t_start_ns = 0
        self.completed = 0
        self.discarded = 0

    def spans(self, usable: BoolArray, *, goes_on: bool, is_last: bool) -> list[tuple[int, int]]:
        """Return (begin, end) of the samples that fill windows; counts windows not filled.

        usable : (n,) of a segment, the samples that may stand in windows
        goes_on : the segment goes on from the last block, with the window begun
        is_last : the segment goes on in the next block
        """
        found = []
        for begin, end in runs(usable):
            filled = self._filled if goes_on and begin == 0 else 0
            total, rest = filled + end - begin, 0
            if not (is_last and end == len(usable)):
                rest = total % self._n
                self.discarded += rest > 0 and (total > self._n or not filled)
            if begin < end - rest:
                found.append((begin, end - rest))
        return found

    def push(
        self, spans: Sequence[Span], series: Series, *, goes_on: bool
    ) -> list[tuple[int, Window]]:
        """Return the windows that spans fill, each with the number of its last sample.

        goes_on : the block's first sample may go on with the window begun
        """
        if self._filled and not (goes_on and spans and spans[0].begin == 0):
            self.discarded += 1
            self._filled = 0
        found = []
        for begin, end, read in spans:
            k = begin
            while k < end:
                stop = min(k + self._n - self._filled, end)
                self._fill(slice(k, stop), series, read[k - begin : stop - begin])
                k = stop
                if self._filled == self._n:
                    found.append((k - 1, self._window(series.t_ns.item(k - 1))))
        return found

    def _fill(self, part: slice, series: Series, bank: FloatArray) -> None:
        """Add samples to the window begun."""
        if self._filled == 0:
            self._t_start_ns = series.t_ns.item(part.start)
            self._measured, self._predicted = np.empty(self._n), np.empty(self._n)
            self._bank = np.empty(self._shape)
        place = slice(self._filled, self._filled + part.stop - part.start)
        self._measured[place] = series.measured[part]
        self._predicted[place] = series.predicted[part]
        self._bank[place] = bank
        self._filled = place.stop

    def _window(self, t_end_ns: int) -> Window:
        self._filled, self.completed = 0, self.completed + 1
        arrays = self._measured, self._predicted, self._bank
        return Window(self.completed - 1, self._t_start_ns, t_end_ns, *arrays, is_cut=self._is_cut)
