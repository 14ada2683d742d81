"""The bank of sensor hypotheses on many signals side by side."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from monitor.base.types import FloatArray, IntArray
from monitor.judge.hypotheses import Hypothesis

_STEPS, _WINDOWS = 32, 16  # worked on at once: what fits into the processor's cache


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
    """What ``hypotheses.SensorBank`` reads, for many signals side by side, in chosen windows.

    hypotheses : in the order of ``build``: healthy, slow, delay; within a kind by direction
    """

    def __init__(self, hypotheses: tuple[Hypothesis, ...], period_s: float) -> None:
        self._slow, slow = _places(hypotheses, "slow")
        first = self._slow.start
        self._sided = {d: slice(p.start - first, p.stop - first) for d, p in slow.items()}
        self._share = np.array(
            [[1.0 - math.exp(-period_s / h.seconds)] for h in hypotheses[self._slow]]
        )
        _, self._late = _places(hypotheses, "delay")
        self._steps = {
            direction: np.array([round(h.seconds / period_s, 9) for h in hypotheses[place]])
            for direction, place in self._late.items()
        }
        self._interpolated = any(bool((each % 1.0).any()) for each in self._steps.values())

    def read(
        self,
        values: FloatArray,
        lengths: Sequence[int],
        row: IntArray,
        begin: IntArray,
        read: FloatArray,
    ) -> None:
        """Fill ``read``, (w, n, n_hypotheses), with what each hypothesis reads in windows.

        values : (rows, length) signals, each begun with a reset
        lengths : of the rows, never increasing; windows lie before them
        row, begin : (w,) where the windows are
        """
        for first in range(0, len(row), _WINDOWS):
            part = slice(first, first + _WINDOWS)
            self._read_late(read[part], values, row[part], begin[part])
        self._read_slow(read, values, lengths, row, begin)

    def _read_late(
        self, read: FloatArray, values: FloatArray, row: IntArray, begin: IntArray
    ) -> None:
        step = begin[:, np.newaxis] + np.arange(read.shape[1])
        base = row[:, np.newaxis] * values.shape[1]
        flat = values.ravel()
        now = flat.take(base + step)[:, :, np.newaxis]
        read[:, :, :1] = now
        known: dict[bytes, FloatArray] = {}
        for direction, place in self._late.items():
            steps = self._steps[direction]
            late = known.get(steps.tobytes())
            if late is None:
                late = known[steps.tobytes()] = self._past(flat, base, step, steps)
            # a one-sided dead time holds the old value only against its own edge direction
            if direction == "symmetric":
                read[:, :, place] = late
            elif direction == "rich_to_lean":
                np.maximum(late, now, out=read[:, :, place])
            else:
                np.minimum(late, now, out=read[:, :, place])

    def _past(
        self, flat: FloatArray, base: IntArray, step: IntArray, steps: FloatArray
    ) -> FloatArray:
        """Return the signal so many steps before each sample, (w, n, n_steps)."""
        whole = steps.astype(np.int64)
        past = step[:, :, np.newaxis] - whole
        late: FloatArray = flat.take(base[:, :, np.newaxis] + np.maximum(past, 0))
        if self._interpolated:
            part = steps - whole
            late *= 1.0 - part
            late += flat.take(base[:, :, np.newaxis] + np.maximum(past - 1, 0)) * part
        return late

    def _read_slow(
        self,
        read: FloatArray,
        values: FloatArray,
        lengths: Sequence[int],
        row: IntArray,
        begin: IntArray,
    ) -> None:
        n = read.shape[1]
        order = np.argsort(begin, kind="stable")
        sorted_begin, last = begin[order], int(begin.max(initial=-n)) + n
        x = np.repeat(values[np.newaxis, :, 0], len(self._share), axis=0)  # (n_slow, rows)
        for low, high, rows in phases(lengths):
            x = x[:, :rows].copy()
            for first in range(low, min(high, last), _STEPS):
                stop = min(first + _STEPS, high)
                seen = self._run_slow(x, values[:rows, first:stop])
                x = seen[-1].copy()
                inside = order[slice(*np.searchsorted(sorted_begin, (first - n + 1, stop)))]
                by_row = seen.transpose(2, 0, 1).copy()  # so that a sample's values lie together
                for i, k, at in zip(
                    inside.tolist(), row[inside].tolist(), begin[inside].tolist(), strict=True
                ):
                    a, b = max(at, first), min(at + n, stop)
                    read[i, a - at : b - at, self._slow] = by_row[k, a - first : b - first]

    def _run_slow(self, x: FloatArray, values: FloatArray) -> FloatArray:
        """Return what the lags read of (rows, n) values, (n, n_slow, rows); x : before them."""
        seen = np.empty((values.shape[1], *x.shape))
        fall, share = np.empty_like(x), np.broadcast_to(self._share, x.shape).copy()
        # the quick direction of a one-sided lag follows at once: the larger, or the smaller, step
        sides = [
            (function, fall[place], place)
            for direction, function in (("rich_to_lean", np.maximum), ("lean_to_rich", np.minimum))
            if (place := self._sided.get(direction))
        ]
        for now, step in zip(values.T.copy(), seen, strict=True):
            np.subtract(now, x, fall)
            np.multiply(fall, share, step)
            for function, quick, place in sides:
                function(quick, step[place], out=step[place])
            np.add(x, step, step)
            x = step
        return seen


def _places(hypotheses: tuple[Hypothesis, ...], kind: str) -> tuple[slice, dict[str, slice]]:
    """Return where a kind of hypotheses stands, and where each direction of it."""
    at = [i for i, h in enumerate(hypotheses) if h.kind == kind]
    found: dict[str, slice] = {}
    for i in at:
        direction = hypotheses[i].direction
        found[direction] = slice(found[direction].start if direction in found else i, i + 1)
    return slice(at[0], at[-1] + 1) if at else slice(0, 0), found
