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
    for kind, grid, limit in (
        ("slow", config.lags_s, config.lag_limit_s),
        ("delay", config.delays_s, config.delay_limit_s),
    ):
        for direction in DIRECTIONS:
            bank += [Hypothesis(f"{kind}_{direction}", kind, direction, s, s > limit) for s in grid]
    return tuple(bank)


class SensorBank:
    """Runs every hypothesis on the predicted signal, one sample at a time."""

    def __init__(self, hypotheses: tuple[Hypothesis, ...], period_s: float) -> None:
        slow = [h for h in hypotheses if h.kind == "slow"]
        late = [h for h in hypotheses if h.kind == "delay"]
        self._slow = np.array([h.kind == "slow" for h in hypotheses])
        self._late = np.array([h.kind == "delay" for h in hypotheses])

        def share(h: Hypothesis, other: str) -> float:
            return 1.0 if h.direction == other else 1.0 - math.exp(-period_s / h.seconds)

        self._rising = np.array([share(h, "rich_to_lean") for h in slow])
        self._falling = np.array([share(h, "lean_to_rich") for h in slow])
        steps = np.array([h.seconds / period_s for h in late])
        self._whole = steps.astype(np.int64)
        self._part = steps - self._whole
        self._interpolated = bool(np.any(self._part > 1e-9))
        self._keep_lower = np.array([h.direction != "rich_to_lean" for h in late])
        self._keep_upper = np.array([h.direction != "lean_to_rich" for h in late])
        self._length = int(self._whole.max(initial=0)) + 2
        self._history = np.ones(self._length)
        self._at = 0
        self._x = np.ones(len(slow))
        self._row = np.ones(len(hypotheses))
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
        self._at = (self._at + 1) % self._length
        self._history[self._at] = value
        step = value - self._x
        self._x += step * np.where(step > 0.0, self._rising, self._falling)
        then = self._history[self._at - self._whole]
        if self._interpolated:
            before = self._history[self._at - self._whole - 1]
            then = then * (1.0 - self._part) + before * self._part
        # a one-sided dead time holds the old value only against its own edge direction
        late = np.where(self._keep_lower & (then < value), then, value)
        late = np.where(self._keep_upper & (then > value), then, late)
        self._row[0] = value
        self._row[self._slow] = self._x
        self._row[self._late] = late
        return self._row
