"""A bank of sensor hypotheses: what a slow or late sensor would read of the predicted signal.

The bank works on phi = 1/lambda, for which rising is lean to rich, or on a signal oriented alike.
"""

import math
from dataclasses import dataclass

import numpy as np

from monitor.config import ResponseConfig
from monitor.types import FloatArray

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

        def share(h: Hypothesis, other: str) -> float:
            return 1.0 if h.direction == other else 1.0 - math.exp(-period_s / h.seconds)

        self._rising = np.array([share(h, "rich_to_lean") for h in slow])
        self._falling = np.array([share(h, "lean_to_rich") for h in slow])
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
        self._step, self._zero = np.empty(len(slow)), np.zeros(())
        self._rises = np.empty(len(slow), dtype=np.bool_)
        self._x = self._row[1 : 1 + len(slow)]  # views: what they hold is the state and the result
        self._late = self._row[1 + len(slow) :]
        falling, rising = (sum(h.direction == d for h in late) for d in DIRECTIONS[:2])
        self._late_falling = self._late[:falling]
        self._late_rising = self._late[falling : falling + rising]
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
        now, step, x = self._now, self._step, self._x
        np.subtract(now, x, step)
        np.greater(step, self._zero, self._rises)
        step *= np.where(self._rises, self._rising, self._falling)
        x += step
        past = self._history[at + 1 : at + 1 + self._length]  # the oldest value first
        past.take(self._places, out=self._late, mode="clip")
        if self._interpolated:
            self._late *= 1.0 - self._part
            self._late += past.take(self._places - 1) * self._part
        # a one-sided dead time holds the old value only against its own edge direction
        np.maximum(self._late_falling, now, out=self._late_falling)
        np.minimum(self._late_rising, now, out=self._late_rising)
        return self._row
