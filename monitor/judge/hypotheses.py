"""A bank of sensor hypotheses: what a slow or late sensor would read of the predicted signal.

The bank works on phi = 1/lambda, for which rising is lean to rich, or on a signal oriented alike.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from monitor.base.config import ResponseConfig
from monitor.base.types import FloatArray

DIRECTIONS = ("rich_to_lean", "lean_to_rich", "symmetric")


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One kind of sensor: healthy, or a lag or dead time on one edge direction or both."""

    fault: str  # name of the fault, "" for a healthy sensor
    kind: str  # "healthy", "slow" or "delay"
    direction: str
    seconds: float  # time constant or dead time
    beyond_limit: bool  # severe enough to be a fault


def build(config: ResponseConfig) -> tuple[Hypothesis, ...]:
    """Return the healthy hypothesis and every lag and dead time of the configuration."""
    bank = [Hypothesis("", "healthy", "symmetric", 0.0, False)]
    for kind, grid, one_sided, symmetric in (
        ("slow", config.lags_s, config.lag_limit_s, config.lag_limit_symmetric_s),
        ("delay", config.delays_s, config.delay_limit_s, config.delay_limit_s),
    ):
        for direction in DIRECTIONS:
            limit = symmetric if direction == "symmetric" else one_sided
            bank += [Hypothesis(f"{kind}_{direction}", kind, direction, s, s > limit) for s in grid]
    return tuple(bank)


class SensorBank:
    """Runs every hypothesis on the predicted signal, one sample at a time.

    hypotheses : in the order of ``build``: healthy, slow, delay; within a kind by direction
    """

    def __init__(self, hypotheses: tuple[Hypothesis, ...], period_s: float) -> None:
        slow = [h for h in hypotheses if h.kind == "slow"]
        late = [h for h in hypotheses if h.kind == "delay"]
        self._share = np.array([1.0 - math.exp(-period_s / h.seconds) for h in slow])
        steps = np.array([round(h.seconds / period_s, 9) for h in late])
        whole = steps.astype(np.int64)
        self._part = steps - whole
        self._interpolated = bool(self._part.any())
        self._length = int(whole.max(initial=0)) + 2
        self._places = self._length - 1 - whole
        self._history = np.ones(2 * self._length)  # everything twice, so that no place wraps
        self._at = 0
        self._row = np.ones(len(hypotheses))
        self._now = self._row[:1].reshape(())  # numpy takes an array faster than a number
        self._way, self._step = np.empty(len(slow)), np.empty(len(slow))
        self._way_falling, self._way_rising = _sided(self._way, slow)
        self._step_falling, self._step_rising = _sided(self._step, slow)
        self._x = self._row[1 : 1 + len(slow)]  # views: what they hold is the state and the result
        self._late = self._row[1 + len(slow) :]
        self._late_falling, self._late_rising = _sided(self._late, late)
        self._started = False

    def reset(self) -> None:
        """Forget the past; the next value fills it."""
        self._started = False

    def push(self, value: float) -> FloatArray:
        """Return what each hypothesis reads now, (n_hypotheses,); the array is used again."""
        if not self._started:
            self._history[:] = value
            self._x[:] = value
            self._started = True
        self._at = at = (self._at + 1) % self._length
        self._history[at] = self._history[at + self._length] = value
        self._row[0] = value
        now, way, step = self._now, self._way, self._step
        np.subtract(now, self._x, way)
        np.multiply(way, self._share, step)
        # a one-sided lag follows at once against its own edge direction
        np.maximum(self._way_falling, self._step_falling, out=self._step_falling)
        np.minimum(self._way_rising, self._step_rising, out=self._step_rising)
        self._x += step
        past = self._history[at + 1 : at + 1 + self._length]  # the oldest value first
        past.take(self._places, out=self._late, mode="clip")
        if self._interpolated:
            self._late *= 1.0 - self._part
            self._late += past.take(self._places - 1) * self._part
        # a one-sided dead time holds the old value only against its own edge direction
        np.maximum(self._late_falling, now, out=self._late_falling)
        np.minimum(self._late_rising, now, out=self._late_rising)
        return self._row


def _sided(values: FloatArray, hypotheses: Sequence[Hypothesis]) -> tuple[FloatArray, FloatArray]:
    """Return the views on those that act on falling and on those that act on rising edges."""
    falling, rising = (sum(h.direction == d for h in hypotheses) for d in DIRECTIONS[:2])
    return values[:falling], values[falling : falling + rising]
