"""Windows of consecutive enabled samples, and what a rule says after one.

The residual is measured minus predicted in the output's unit. The response rule works on signals
oriented like phi = 1/lambda, for which rising is lean to rich.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from monitor.base.runs import runs
from monitor.base.types import BoolArray, FloatArray

Outcome = Literal["passed", "failed", "inconclusive"]


@dataclass(frozen=True, slots=True)
class Opinion:
    """The finding of a rule on all windows so far."""

    outcome: Outcome = "inconclusive"
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


class Windows:
    """Fills windows that do not overlap; an interruption discards the window begun."""

    def __init__(self, n_samples: int, *, is_cut: bool = False) -> None:
        self._n, self._is_cut = n_samples, is_cut
        self._begun: list[list[NDArray[Any]]] = []  # pieces of it: times, readings, bank
        self._filled = 0  # samples of the window begun
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
        self, spans: Sequence[Span], series: Sequence[NDArray[Any]], *, goes_on: bool
    ) -> list[tuple[int, Window]]:
        """Return the windows that spans fill, each with the number of its last sample.

        series : of the block: times in ns, measured and predicted values, (n,) each
        goes_on : the block's first sample may go on with the window begun
        """
        if self._filled and not (goes_on and spans and spans[0].begin == 0):
            self.discarded += 1
            self._begun, self._filled = [], 0
        found = []
        for begin, end, bank in spans:
            self._begun.append([*(column[begin:end] for column in series), bank])
            self._filled += end - begin
            if self._filled < self._n:
                continue
            own = [np.concatenate(pieces) for pieces in zip(*self._begun, strict=True)]
            for k in range(self._n, self._filled + 1, self._n):
                t_ns, y, predicted, read = (column[k - self._n : k] for column in own)
                begins, ends = t_ns.item(0), t_ns.item(-1)
                window = Window(self.completed, begins, ends, y, predicted, read, self._is_cut)
                found.append((end - self._filled + k - 1, window))
                self.completed += 1
            self._filled %= self._n
            self._begun = [[column[-self._filled :].copy() for column in own]] * (self._filled > 0)
        return found


def oriented(values: FloatArray, transform: str) -> FloatArray:
    """Return values oriented like phi; NaN where lambda is not above zero.

    transform : "phi" for lambda, which becomes 1/lambda; "none" for an output that rises towards
        lean as lambda does, which is negated
    """
    if transform != "phi":
        return -values
    return np.asarray(1.0 / np.where(values > 0.0, values, np.nan))


def lambda_of(oriented_values: FloatArray, transform: str) -> FloatArray:
    """Return values oriented like phi, none of them 0, in the output's unit again."""
    return 1.0 / oriented_values if transform == "phi" else -oriented_values
