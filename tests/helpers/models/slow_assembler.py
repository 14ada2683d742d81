"""The rules of the sample grid frame by frame, as the reference of the block assembler."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from monitor.base.types import Quality, Sample
from monitor.decode.signal_map import Derived
from monitor.grid.block_assembler import MAX_JUMP_NS, MAX_LATE, AssemblerCounters
from monitor.grid.derived import Output


class SlowAssembler:
    """Takes one frame at a time: its time and the values that it carries, by channel."""

    def __init__(
        self,
        channels: Sequence[str],
        names: Sequence[str],
        period_ns: int,
        timeouts_ns: Sequence[int],
        derived: Sequence[Derived] = (),
    ) -> None:
        n = len(channels)
        self.counters, self.is_off_bus = AssemblerCounters(), False
        self._output, self._n_names = Output(channels, names, derived), len(names)
        self._period_ns, self._timeouts_ns = period_ns, timeouts_ns
        self._came_ns = [0] * n
        self._index, self._late = 0, 0
        self._first_ns: int | None = None  # of the open tick
        self._end_ns = self._newest_ns = 0
        self._gap_ns: int | None = None
        self._forget(Quality.STALE)

    def _forget(self, quality: Quality) -> None:
        n = len(self._came_ns)
        self._values: list[list[float]] = [[] for _ in range(n)]
        self._held, self._quality = [math.nan] * n, [quality] * n

    def push(self, t_ns: int, values: Mapping[int, float]) -> list[Sample]:
        if self._first_ns is None:
            self._anchor(t_ns)
        found = []
        if t_ns - self._newest_ns > MAX_JUMP_NS:
            found = [self._close(), self._break(t_ns, Quality.STALE)]
        elif t_ns < (self._first_ns or 0):
            self.counters.late += 1
            self._late += 1
            if self._late < MAX_LATE:
                return []
            found = [self._break(t_ns, Quality.STALE)]
        self._late = 0
        while t_ns > self._end_ns:
            found.append(self._close())
        self._newest_ns = max(self._newest_ns, t_ns)
        for channel, value in values.items():
            self._values[channel].append(value)
            self._came_ns[channel] = t_ns
        return found

    def gap(self, t_ns: int) -> list[Sample]:
        is_first, self._late = self._first_ns is None, 0
        if is_first:
            self._anchor(t_ns)
            return []
        return [self._break(t_ns, Quality.GAP)]

    def _anchor(self, t_ns: int) -> None:
        self._first_ns = self._newest_ns = t_ns
        self._end_ns = t_ns + self._period_ns

    def _break(self, t_ns: int, quality: Quality) -> Sample:
        self.counters.discontinuities += 1
        self._forget(quality)
        self._anchor(t_ns)
        self._gap_ns = t_ns if quality == Quality.GAP else None
        self._index += 1
        marks = np.full(self._n_names, quality, dtype=np.uint8)
        return Sample(self._index, t_ns, np.full(self._n_names, math.nan), marks)

    def _close(self) -> Sample:
        end_ns = self._end_ns
        for channel, values in enumerate(self._values):
            good = [value for value in values if math.isfinite(value)]
            timeout_ns = self._timeouts_ns[channel]
            if good:
                total = 0.0
                for value in good:
                    total += value
                self._held[channel] = total / len(good)
                self._quality[channel] = Quality.GOOD
            elif values:
                self._held[channel] = math.nan
                is_out = any(map(math.isinf, values))
                self._quality[channel] = Quality.OUT_OF_RANGE if is_out else Quality.INVALID
            elif end_ns - self._came_ns[channel] > timeout_ns:
                self._held[channel] = math.nan
                is_new = self._gap_ns is not None and end_ns - self._gap_ns <= timeout_ns
                self._quality[channel] = Quality.GAP if is_new else Quality.STALE
                if self.is_off_bus:
                    self._quality[channel] = Quality.OFF_BUS
        self._values = [[] for _ in self._values]
        held, quality = np.array([self._held]), np.array([self._quality], dtype=np.uint8)
        values, marks = self._output.of(held, quality)
        self._index += 1
        self._first_ns, self._end_ns = end_ns + 1, end_ns + self._period_ns
        return Sample(self._index, end_ns, values[0], marks[0])
