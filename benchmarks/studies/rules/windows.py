"""Windows for the rules of the literature, the interface of a rule, and its limit."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from monitor.pipeline.events import WindowJudged


@dataclass(frozen=True, slots=True)
class Windows:
    """Windows of measured and predicted output, side by side."""

    measured: FloatArray  # (n, n_samples) output's unit
    predicted: FloatArray  # (n, n_samples)

    def __len__(self) -> int:
        return len(self.measured)

    @property
    def residual(self) -> FloatArray:
        """Return measured minus predicted, (n, n_samples)."""
        return self.measured - self.predicted

    @classmethod
    def of(cls, drives: Sequence[Sequence[WindowJudged]]) -> Self:
        """Return the windows of several drives in their order.

        Raises RecordingError if the drives have no window.
        """
        windows = [w.window for drive in drives for w in drive]
        if not windows:
            raise RecordingError("no window in any drive, at least one is wanted")
        return cls(
            np.array([w.measured for w in windows]), np.array([w.predicted for w in windows])
        )


class Rule(Protocol):
    """A decision rule for single windows."""

    @classmethod
    def fit(cls, healthy: Windows, faulty: Windows, false_alarm_rate: float) -> Self:
        """Return the rule, set on healthy windows and, by some rules, on faulty ones.

        faulty : windows of sensors at the limit severity
        false_alarm_rate : per healthy window, above 0 and below 1
        Raises RecordingError if there are too few healthy windows.
        """
        ...

    def faulty(self, windows: Windows) -> np.ndarray:
        """Return the verdict on each window, (n,) bool."""
        ...


def limit_for(scores: FloatArray, false_alarm_rate: float) -> float:
    """Return the limit that a new healthy window reaches with at most the false-alarm rate.

    scores : (n,) scores of healthy windows
    The limit lies just above the order statistic ceil((n + 1) (1 - rate)). The rate holds for
    exchangeable windows of any distribution. Windows of one drive resemble each other, so a
    comparison of rules states the measured rate.
    Raises RecordingError if there are too few scores.
    Source: Vovk, Gammerman and Shafer, Algorithmic Learning in a Random World, section 2.2.

    >>> limit_for(np.arange(19.0), 0.05) > 18.0
    True
    """
    n = len(scores)
    rank = math.ceil((n + 1) * (1.0 - false_alarm_rate) - 1e-9)
    if not 0.0 < false_alarm_rate < 1.0 or rank > n:
        needed = math.ceil(1.0 / false_alarm_rate) - 1 if false_alarm_rate > 0.0 else "infinitely"
        raise RecordingError(
            f"{n} healthy windows, {needed} are wanted for a false-alarm rate of "
            f"{false_alarm_rate:g} per window"
        )
    reached = float(np.sort(scores)[max(rank, 1) - 1])
    return reached + 1e-9 * max(abs(reached), 1e-9)
