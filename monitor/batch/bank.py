"""The bank of sensor hypotheses on many signals side by side."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from monitor.hypotheses import Hypothesis
from monitor.types import FloatArray, IntArray

_STEPS, _PLACES = 128, 4096  # worked on at once: what fits into the processor's cache


def phases(lengths: Sequence[int]) -> Iterator[tuple[int, int, int]]:
    """Yield begin, end and how many rows are to run, so that finished rows drop out by halves.

    lengths : of the rows, never increasing

    >>> list(phases([9, 9, 4, 2]))
    [(0, 4, 4), (4, 9, 2)]
    """
    begin = 0
    while begin < lengths[0]:
        rows = sum(length > begin for length in lengths)
        yield begin, (begin := lengths[rows // 2]), rows


class BankBlock:
    """What ``hypotheses.SensorBank`` reads, for many signals side by side, at chosen samples."""

    def __init__(self, hypotheses: tuple[Hypothesis, ...], period_s: float) -> None:
        self._hypotheses = hypotheses
        self._slow = np.flatnonzero([h.kind == "slow" for h in hypotheses])
        slow = [hypotheses[i] for i in self._slow]

        def share(h: Hypothesis, other: str) -> float:
            return 1.0 if h.direction == other else 1.0 - math.exp(-period_s / h.seconds)

        self._rising = np.array([[share(h, "rich_to_lean")] for h in slow])  # (n_slow, 1)
        self._falling = np.array([[share(h, "lean_to_rich")] for h in slow])
        self._steps = [round(h.seconds / period_s, 9) for h in hypotheses]
        self._interpolated = any(
            steps % 1.0
            for steps, h in zip(self._steps, hypotheses, strict=True)
            if h.kind == "delay"
        )

    def read(
        self, values: FloatArray, lengths: Sequence[int], row: IntArray, step: IntArray
    ) -> FloatArray:
        """Return what each hypothesis reads at the chosen samples, (m, n_hypotheses).

        values : (rows, n) signals, each begun with a reset
        lengths : of the rows, never increasing; chosen samples lie before them
        row, step : (m,) which samples
        """
        read = np.empty((len(row), len(self._hypotheses)))
        for first in range(0, len(row), _PLACES):
            part = slice(first, first + _PLACES)
            self._read_late(read[part], values, row[part], step[part])
        self._read_slow(read, values, lengths, row, step)
        return read

    def _read_late(
        self, read: FloatArray, values: FloatArray, row: IntArray, step: IntArray
    ) -> None:
        now = values[row, step]
        for i, h in enumerate(self._hypotheses):
            if h.kind == "healthy":
                read[:, i] = now
            elif h.kind == "delay":
                read[:, i] = self._late(h.direction, self._steps[i], values, now, row, step)

    def _late(
        self, direction: str, steps: float, values: FloatArray, now: FloatArray,
        row: IntArray, step: IntArray,
    ) -> FloatArray:  # fmt: skip
        whole = int(steps)
        late = values[row, np.maximum(step - whole, 0)]
        if self._interpolated:
            part = steps - whole
            late *= 1.0 - part
            late += values[row, np.maximum(step - whole - 1, 0)] * part
        if direction == "symmetric":
            return late
        # a one-sided dead time holds the old value only against its own edge direction
        return (np.maximum if direction == "rich_to_lean" else np.minimum)(late, now)

    def _read_slow(
        self, read: FloatArray, values: FloatArray, lengths: Sequence[int],
        row: IntArray, step: IntArray,
    ) -> None:  # fmt: skip
        order = np.argsort(step, kind="stable")
        sorted_step, last = step[order], int(step.max(initial=-1))
        x = np.repeat(values[np.newaxis, :, 0], len(self._slow), axis=0)  # (n_slow, rows)
        for begin, end, rows in phases(lengths):
            x = x[:, :rows].copy()
            for first in range(begin, min(end, last + 1), _STEPS):
                stop = min(first + _STEPS, end)
                seen = self._run_slow(x, values[:rows, first:stop])
                chosen = order[slice(*np.searchsorted(sorted_step, (first, stop)))]
                read[np.ix_(chosen, self._slow)] = seen[step[chosen] - first, :, row[chosen]]

    def _run_slow(self, x: FloatArray, values: FloatArray) -> FloatArray:
        """Run the lags on (rows, n) values; return (n, n_slow, rows) and leave the last in x."""
        seen = np.empty((values.shape[1], *x.shape))
        fall, rises = np.empty_like(x), np.empty(x.shape, dtype=np.bool_)
        for now, rise in zip(values.T.copy(), seen, strict=True):
            np.subtract(now, x, out=fall)
            np.greater(fall, 0.0, out=rises)
            np.multiply(fall, self._rising, out=rise)
            fall *= self._falling
            np.copyto(fall, rise, where=rises)
            x += fall
            rise[:] = x
        return seen
