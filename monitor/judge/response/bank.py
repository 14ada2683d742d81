"""A bank of sensor hypotheses, and the claims that are made of them.

The bank gives the readings of slow and late sensors of the predicted signal; a claim is one of them
with a range of its gain. The bank works on phi = 1/lambda, for which rising is lean to rich, or on
a signal oriented alike. It runs many signals side by side, block by block.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final, NamedTuple

import numpy as np

from monitor.base.config import ResponseConfig
from monitor.base.faults import TRANSIENT_GAIN
from monitor.base.types import FloatArray

EDGES: Final = ("rich_to_lean", "lean_to_rich")
DIRECTIONS: Final = (*EDGES, "symmetric")
# a slow sensor with at least this gain is only slow, with less it is weak, too
SLOW_LEAST: Final = math.sqrt(TRANSIENT_GAIN)


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One kind of sensor: healthy, or a lag or dead time on one edge direction or both."""

    fault: str  # name of the fault, "" for a healthy sensor
    kind: str  # "healthy", "slow" or "delay"
    direction: str
    seconds: float  # time constant or dead time
    beyond_limit: bool  # severe enough to be a fault
    near_limit: bool = False  # no fault, but one if the prediction is late by ``timing_s``


def build(config: ResponseConfig) -> tuple[Hypothesis, ...]:
    """Return the healthy hypothesis and every lag and dead time of the configuration."""
    bank = [Hypothesis("", "healthy", "symmetric", 0.0, False)]
    for kind, grid, one_sided, symmetric in (
        ("slow", config.lags_s, config.lag_limit_s, config.lag_limit_symmetric_s),
        ("delay", config.delays_s, config.delay_limit_s, config.delay_limit_s),
    ):
        for direction in DIRECTIONS:
            limit = symmetric if direction == "symmetric" else one_sided
            near = limit - config.timing_s
            bank += [
                Hypothesis(f"{kind}_{direction}", kind, direction, s, s > limit, near < s <= limit)
                for s in grid
            ]
    return tuple(bank)


@dataclass(frozen=True, slots=True)
class SensorClaim:
    """A sensor with this lag or dead time and a gain in this range, over a healthy sensor's."""

    column: int  # of the bank; behind its last one stands the sensor quicker than the model's
    hypothesis: Hypothesis
    gain_low: float
    gain_high: float
    fault: str  # "" is a sound sensor


@cache
def claims(config: ResponseConfig) -> tuple[SensorClaim, ...]:
    """Return every claim about the sensor, that of a sound and punctual one first."""
    least, top = config.gain_least, config.gain_max
    found, bank = [], build(config)
    # behind the bank a sensor quicker than the training vehicle's; without it a dead time of one
    # period of a steady modulation explains such a sensor better than none
    for column, each in enumerate((*bank, bank[0])):
        if not each.beyond_limit:
            found.append(SensorClaim(column, each, config.gain_sound_min, top, ""))
            found.append(SensorClaim(column, each, least, config.gain_weak_max, "gain_low"))
        elif each.kind == "delay":
            found.append(SensorClaim(column, each, config.gain_weak_max, top, each.fault))
        else:
            found.append(SensorClaim(column, each, SLOW_LEAST, top, each.fault))
            if each.direction == "symmetric":
                found.append(SensorClaim(column, each, least, SLOW_LEAST, "transient"))
    return tuple(found)


class BankState(NamedTuple):
    """The past of one signal, as far as the bank remembers it."""

    lags: FloatArray  # (n_slow,) what each lag reads
    past: FloatArray  # (n_past,) last values, the latest last


class Bank:
    """Runs every hypothesis on signals side by side; its readings have the order of ``build``."""

    def __init__(self, config: ResponseConfig, period_s: float) -> None:
        share = [1.0 - math.exp(-period_s / lag_s) for lag_s in config.lags_s]
        self._n_lags, self._share = len(share), np.tile(share, len(DIRECTIONS))[:, np.newaxis]
        steps = np.array([round(delay_s / period_s, 9) for delay_s in config.delays_s])
        self._whole = steps.astype(np.int64)
        self._part = steps - self._whole
        self._n_past = int(self._whole.max()) + 1
        self._n_slow = len(self._share)
        self._width = 1 + self._n_slow + len(DIRECTIONS) * len(steps)

    def begin(self, value: float) -> BankState:
        """Return the state of a signal that has always been ``value``."""
        return BankState(np.full(self._n_slow, value), np.full(self._n_past, value))

    def push(
        self,
        values: FloatArray,
        lengths: Sequence[int],
        states: Sequence[BankState],
        spans: Sequence[tuple[int, int, int]],
    ) -> tuple[list[FloatArray], list[BankState]]:
        """Return the readings in each span, (end - begin, n_hypotheses), and the signals' states.

        values : (rows, length) signals
        lengths : of the signals; the states are those at their ends
        spans : row, begin and end of the samples that are read
        """
        past = np.array([state.past for state in states])
        signals = np.concatenate([past, values], axis=1)
        lags = self._lags(values, np.array([state.lags for state in states]).T)
        read = [np.empty((end - begin, self._width)) for _, begin, end in spans]
        for own, (row, begin, end) in zip(read, spans, strict=True):
            self._read_late(own, signals[row], begin)
            own[:, 1 : 1 + self._n_slow] = lags[row, begin:end]
        return read, [
            BankState(lags[row, n - 1].copy(), signals[row, n : n + self._n_past].copy())
            for row, n in enumerate(lengths)
        ]

    def _read_late(self, read: FloatArray, signal: FloatArray, begin: int) -> None:
        """Fill in the signal as many steps before each sample as each dead time says."""
        at = np.arange(begin, begin + len(read))[:, np.newaxis] + self._n_past
        now, before = signal.take(at), at - self._whole
        late: FloatArray = signal.take(before)
        if self._part.any():
            late *= 1.0 - self._part
            late += signal.take(before - 1) * self._part
        read[:, :1] = now
        # a one-sided dead time holds the old value only against its own edge direction
        n = len(self._whole)
        np.maximum(late, now, out=read[:, -3 * n : -2 * n])
        np.minimum(late, now, out=read[:, -2 * n : -n])
        read[:, -n:] = late

    def _lags(self, values: FloatArray, x: FloatArray) -> FloatArray:
        """Return the lags' readings of (rows, n) values, (rows, n, n_slow).

        x : (n_slow, rows) before them
        """
        n, fall, share = self._n_lags, np.empty_like(x), np.repeat(self._share, x.shape[1], axis=1)
        seen = np.empty((values.shape[1], *x.shape))
        rises, falls = fall[:n], fall[n : 2 * n]
        quick = zip(seen[:, :n], seen[:, n : 2 * n], strict=True)
        for now, step, (to_lean, to_rich) in zip(values.T.copy(), seen, quick, strict=True):
            np.subtract(now, x, fall)
            np.multiply(fall, share, step)
            # the quick direction of a one-sided lag follows at once
            np.maximum(rises, to_lean, out=to_lean)
            np.minimum(falls, to_rich, out=to_rich)
            np.add(x, step, step)
            x = step
        return seen.transpose(2, 0, 1)
