"""Windows of consecutive enabled samples, and what a rule says after one."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

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

    def __init__(self, n_samples: int, *, is_cut: bool = False) -> None:
        self._n, self._is_cut = n_samples, is_cut
        self._begun: list[NDArray[Any]] = []  # of the window begun: times, readings, bank
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
            filled = len(self._begun[0]) if self._begun and goes_on and begin == 0 else 0
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
        if self._begun and not (goes_on and spans and spans[0].begin == 0):
            self.discarded += 1
            self._begun = []
        found = []
        for begin, end, read in spans:
            now = *(column[begin:end] for column in series), read
            both = zip(self._begun, now, strict=True) if self._begun else ((each,) for each in now)
            own = [np.concatenate(each) for each in both]
            n_own = len(own[0])
            for k in range(self._n, n_own + 1, self._n):
                window = self._window(*(column[k - self._n : k] for column in own))
                found.append((end - n_own + k - 1, window))
            rest = n_own % self._n
            self._begun = [column[-rest:].copy() for column in own] if rest else []
        return found

    def _window(
        self, t_ns: IntArray, measured: FloatArray, predicted: FloatArray, bank: FloatArray
    ) -> Window:
        self.completed += 1
        return Window(
            index=self.completed - 1,
            t_start_ns=t_ns.item(0),
            t_end_ns=t_ns.item(-1),
            measured=measured,
            predicted=predicted,
            bank=bank,
            is_cut=self._is_cut,
        )
