"""Counts over a recording: how often each condition held, and in which state each signal was.

The last samples tell whether the sensor was alive at its end: a test that passed early says nothing
of a sensor that dies later, and a fault needs a few seconds until it sets a code.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from monitor.base.config import Config, PlausibilityConfig
from monitor.base.types import BoolArray, FloatArray, IntArray, Quality, QualityArray
from monitor.judge.electrical.plausibility import ENGINE, READY
from monitor.judge.enable import CONDITIONS, Enable, Range
from monitor.model.card import ModelCard

_BATCH = 2048  # samples that are counted together; a live sample alone would cost more
DEAD: Final = {  # in words
    "stale": "came no longer",
    "invalid": "had no value",
    "out_of_range": "was out of range",
    "not_ready": "was not ready",
    "frozen": "did not move any more",
    "pegged": "stood at the end of its range",
}
_OF_QUALITY: Final = {  # any other is told by its name
    Quality.GOOD: "not_ready",
    Quality.OFF_BUS: "stale",
    Quality.GAP: "invalid",  # the log left it out
    Quality.PINNED: "pegged",
}
_VALID: Final = CONDITIONS.index("measured_valid")
_RECOVERED: Final = CONDITIONS.index("fuel_cut_recovered")


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
        # values, quality and conditions of the last samples, (n_end, …); none before the first
        self.end: tuple[NDArray[Any], ...] = ()
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
        blocks = [self.end] * bool(self.end) + [(values, quality, conditions)]
        self.end = tuple(np.concatenate(each)[-self._n_end :] for each in zip(*blocks, strict=True))
        return self


def dead_at_end(seen: Observation, card: ModelCard, config: Config) -> str | None:
    """Return how the sensor was dead when the recording ended, a key of DEAD; None if it was alive.

    A sensor need not be alive while the engine stands. It was dead if it gave no usable value in
    the last samples, or if its last values are all alike. In a fuel cut a healthy sensor stands
    still at the end of its range.
    """
    own, output = config.plausibility, card.output
    silent, still = (round(s / seen.period_s) for s in (own.end_s, own.stuck_s))
    values, qualities, conditions = seen.end
    read = dict(zip(seen.names, values.T, strict=True))
    measured, quality = read[output.name], qualities[:, seen.names.index(output.name)]
    burning = conditions[:, _RECOVERED]
    # a speed that is no longer known holds on; one not known at all belongs to an ECU that sleeps,
    # for awake, its silence would have set a code
    speed_rpm = read.get(ENGINE, np.full(len(values), np.inf))
    known = np.maximum.accumulate(np.where(np.isnan(speed_rpm), 0, np.arange(len(values))))
    running = speed_rpm[known] >= own.engine_running_rpm
    gone = quality != Quality.GOOD  # in a fuel cut a pinned reading is the right one
    gone &= (quality != Quality.PINNED) | burning
    if READY in read:
        gone |= read[READY] <= 0.0
    n = max(silent, 1)
    if len(values) >= n and (gone & running)[-n:].all():
        last = Quality(quality.item(-1))
        return _OF_QUALITY.get(last, last.name.lower())
    n = max(still, 2)
    moves = np.ptp(measured[-n:]) > own.stuck_range
    is_valid = len(values) >= n and (conditions[:, _VALID] & running)[-n:].all()
    if moves or not is_valid:
        return None
    if measured[-1] < output.maximum:
        return "frozen"
    return "pegged" if np.count_nonzero(burning[-n:]) >= max(silent, 2) else None
