"""Counts over a recording: how often each condition held, and in which state each signal was."""

from collections.abc import Sequence

import numpy as np

from monitor.base.config import PlausibilityConfig
from monitor.base.types import BoolArray, FloatArray, IntArray, Quality, QualityArray
from monitor.judge.enable import CONDITIONS, Enable, Range

_BATCH = 2048  # samples that are counted together; a live sample alone would cost more


class Observation:
    """Counts the findings on samples; ``observed`` brings what can be read up to date.

    enable : conditions of the recording
    names : signals of a sample
    """

    def __init__(
        self, enable: Enable, names: Sequence[str], config: PlausibilityConfig, period_s: float
    ) -> None:
        self.names, self.unavailable, self.ranges = tuple(names), enable.unavailable, enable.ranges
        self.period_s, self._constant_s = period_s, config.constant_s
        self._places = [self.names.index(each.signal) for each in self.ranges]
        self._n_end = max(round(max(config.stuck_s, config.end_s) / period_s), 2)
        n, n_ranges = len(names), len(self.ranges)
        self.samples = self.enabled = 0  # on these all conditions held
        self.held: IntArray = np.zeros(len(CONDITIONS), dtype=np.int64)  # on these each did
        self.quality: IntArray = np.zeros((len(Quality), n), dtype=np.int64)
        self.low: FloatArray = np.full(n, np.inf)  # least good value
        self.high: FloatArray = np.full(n, -np.inf)
        self.below: IntArray = np.zeros(n_ranges, dtype=np.int64)  # samples below each range
        self.above: IntArray = np.zeros(n_ranges, dtype=np.int64)
        self.stale_runs: IntArray = np.zeros(n, dtype=np.int64)  # times that it went stale
        self._was_silent = np.zeros(n, dtype=np.bool_)
        # the last samples, (n_end, …)
        self.end_values: FloatArray = np.empty((0, n))
        self.end_quality: QualityArray = np.empty((0, n), dtype=np.uint8)
        self.end_conditions: BoolArray = np.empty((0, len(CONDITIONS)), dtype=np.bool_)
        self._waiting: list[tuple[FloatArray, QualityArray, BoolArray]] = []
        self._n_waiting = 0

    def share(self, condition: str) -> float:
        """Return the share of samples on which a condition held, 0 to 1."""
        return int(self.held[CONDITIONS.index(condition)]) / max(self.samples, 1)

    def of(self, name: str, quality: Quality) -> int:
        """Return on how many samples a signal had a quality."""
        return int(self.quality[quality, self.names.index(name)])

    def outside(self, condition: str) -> dict[str, tuple[int, int, Range]]:
        """Return by signal on how many samples it was below and above the condition's range."""
        counts = zip(self.below.tolist(), self.above.tolist(), self.ranges, strict=True)
        return {each[2].signal: each for each in counts if each[2].condition == condition}

    def is_constant(self, name: str) -> bool:
        """Return whether a signal had one good value only, over longer than it takes to move."""
        i = self.names.index(name)
        is_long = self.of(name, Quality.GOOD) * self.period_s >= self._constant_s
        return is_long and bool(self.low[i] == self.high[i])

    def push(self, values: FloatArray, quality: QualityArray, conditions: BoolArray) -> None:
        """Take samples: values and quality (n, n_names), conditions (n, n_conditions)."""
        self._waiting.append((values, quality, conditions))
        self._n_waiting += len(values)
        if self._n_waiting >= _BATCH:
            self.observed()

    def observed(self) -> "Observation":
        """Return it with all samples so far counted."""
        if not self._n_waiting:
            return self
        values, quality, conditions = map(np.concatenate, zip(*self._waiting, strict=True))
        self._waiting, self._n_waiting = [], 0
        self.samples += len(values)
        self.held += np.add.reduce(conditions, axis=0, dtype=np.int64)
        self.enabled += int(np.count_nonzero(np.logical_and.reduce(conditions, axis=1)))
        for code in range(len(Quality)):
            self.quality[code] += np.count_nonzero(quality == code, axis=0)
        self.low = np.fmin(self.low, np.fmin.reduce(values, axis=0))
        self.high = np.fmax(self.high, np.fmax.reduce(values, axis=0))
        for i, (place, each) in enumerate(zip(self._places, self.ranges, strict=True)):
            self.below[i] += np.count_nonzero(values[:, place] < each.low)
            self.above[i] += np.count_nonzero(values[:, place] > each.high)
        silent = (quality == Quality.STALE) | (quality == Quality.OFF_BUS)
        before = np.vstack([self._was_silent, silent[:-1]])
        self.stale_runs += np.count_nonzero(silent & ~before, axis=0)
        self._was_silent = silent[-1].copy()
        n = self._n_end
        self.end_values = np.concatenate([self.end_values, values[-n:]])[-n:]
        self.end_quality = np.concatenate([self.end_quality, quality[-n:]])[-n:]
        self.end_conditions = np.concatenate([self.end_conditions, conditions[-n:]])[-n:]
        return self
