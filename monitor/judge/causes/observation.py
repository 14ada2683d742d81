"""Counts over a recording: how often each condition held, and in which state each signal was."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from monitor.base.config import PlausibilityConfig
from monitor.base.runs import runs
from monitor.base.types import BoolArray, FloatArray, IntArray, Quality, QualityArray
from monitor.judge.enable import CONDITIONS, Enable, Range

_BATCH = 2048  # samples that are counted together; a live sample alone would cost more
_STALE, _OFF_BUS = int(Quality.STALE), int(Quality.OFF_BUS)


@dataclass(frozen=True, slots=True)
class Observed:
    """The counts at a recording's end."""

    names: tuple[str, ...]
    unavailable: tuple[str, ...]  # conditions without their signal
    ranges: tuple[Range, ...]
    period_s: float
    constant_s: float  # time within which a signal moves
    samples: int
    held: IntArray  # (n_conditions,) samples on which each condition held
    enabled: int  # samples on which all conditions held
    quality: IntArray  # (n_qualities, n_names) samples
    low: FloatArray  # (n_names,) least good value, inf without one
    high: FloatArray  # (n_names,) greatest good value, -inf without one
    below: IntArray  # (n_ranges,) samples below each range
    above: IntArray  # (n_ranges,) samples above each range
    stale_runs: IntArray  # (n_names,) times that each signal went stale
    end_values: FloatArray  # (n_end, n_names) of the last samples
    end_quality: QualityArray  # (n_end, n_names)
    end_conditions: BoolArray  # (n_end, n_conditions)

    def share(self, condition: str) -> float:
        """Return the share of samples on which a condition held, 0 to 1."""
        return int(self.held[CONDITIONS.index(condition)]) / max(self.samples, 1)

    def is_constant(self, name: str) -> bool:
        """Return whether a signal had one good value only, over longer than it takes to move."""
        i = self.names.index(name)
        good = int(self.quality[Quality.GOOD, i])
        return good * self.period_s >= self.constant_s and bool(self.low[i] == self.high[i])


class Observation:
    """Counts the findings on samples.

    enable : conditions of the recording
    names : signals of a sample
    """

    def __init__(
        self, enable: Enable, names: Sequence[str], config: PlausibilityConfig, period_s: float
    ) -> None:
        n, self._ranges = len(names), enable.ranges
        self._names, self._unavailable = tuple(names), enable.unavailable
        self._period_s, self._constant_s = period_s, config.constant_s
        self._places = np.array([self._names.index(each.signal) for each in self._ranges])
        self._range_low = np.array([each.low for each in self._ranges])
        self._range_high = np.array([each.high for each in self._ranges])
        self._n_end = max(round(max(config.stuck_s, config.end_s) / period_s), 2)
        self._samples = self._enabled = 0
        self._held = np.zeros(len(CONDITIONS), dtype=np.int64)
        self._quality = np.zeros((len(Quality), n), dtype=np.int64)
        self._low, self._high = np.full(n, np.inf), np.full(n, -np.inf)
        self._below, self._above = (np.zeros(len(self._ranges), dtype=np.int64) for _ in range(2))
        self._stale_runs = np.zeros(n, dtype=np.int64)
        self._was_silent = np.zeros(n, dtype=np.bool_)
        self._end = (
            np.empty((0, n)),
            np.empty((0, n), dtype=np.uint8),
            np.empty((0, len(CONDITIONS)), dtype=np.bool_),
        )
        self._waiting: list[tuple[FloatArray, QualityArray, BoolArray]] = []
        self._n_waiting = 0

    @property
    def held(self) -> IntArray:
        """Return on how many samples each condition held, (n_conditions,)."""
        self._count()
        return self._held

    def push(self, values: FloatArray, quality: QualityArray, conditions: BoolArray) -> None:
        """Take samples: values and quality (n, n_names), conditions (n, n_conditions)."""
        self._waiting.append((values, quality, conditions))
        self._n_waiting += len(values)
        if self._n_waiting >= _BATCH:
            self._count()

    def observed(self) -> Observed:
        """Return the counts so far."""
        self._count()
        return Observed(
            names=self._names,
            unavailable=self._unavailable,
            ranges=self._ranges,
            period_s=self._period_s,
            constant_s=self._constant_s,
            samples=self._samples,
            held=self._held.copy(),
            enabled=self._enabled,
            quality=self._quality.copy(),
            low=self._low.copy(),
            high=self._high.copy(),
            below=self._below.copy(),
            above=self._above.copy(),
            stale_runs=self._stale_runs.copy(),
            end_values=self._end[0],
            end_quality=self._end[1],
            end_conditions=self._end[2],
        )

    def _count(self) -> None:
        if not self._n_waiting:
            return
        values, quality, conditions = (
            np.concatenate(parts) for parts in zip(*self._waiting, strict=True)
        )
        self._waiting, self._n_waiting = [], 0
        self._samples += len(values)
        self._held += np.add.reduce(conditions, axis=0, dtype=np.int64)
        self._enabled += int(np.count_nonzero(np.logical_and.reduce(conditions, axis=1)))
        for code in range(len(Quality)):
            self._quality[code] += np.count_nonzero(quality == code, axis=0)
        self._low = np.fmin(self._low, np.fmin.reduce(values, axis=0))
        self._high = np.fmax(self._high, np.fmax.reduce(values, axis=0))
        x = values.take(self._places, axis=1)
        self._below += np.count_nonzero(x < self._range_low, axis=0)
        self._above += np.count_nonzero(x > self._range_high, axis=0)
        self._count_stale((quality == _STALE) | (quality == _OFF_BUS))
        self._end = (
            np.concatenate([self._end[0], values])[-self._n_end :].copy(),
            np.concatenate([self._end[1], quality])[-self._n_end :].copy(),
            np.concatenate([self._end[2], conditions])[-self._n_end :].copy(),
        )

    def _count_stale(self, silent: BoolArray) -> None:
        for i in np.flatnonzero(silent.any(axis=0)).tolist():
            found = runs(silent[:, i])
            goes_on = bool(self._was_silent[i]) and found[0][0] == 0
            self._stale_runs[i] += len(found) - goes_on
        self._was_silent = silent[-1].copy()
