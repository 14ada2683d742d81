"""A bank of sensor hypotheses: readings of slow and late sensors of the predicted signal.

The bank works on phi = 1/lambda, for which rising is lean to rich, or on a signal oriented alike.
It runs many signals side by side, block by block.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from monitor.base.config import ResponseConfig
from monitor.base.types import FloatArray, IntArray

DIRECTIONS = ("rich_to_lean", "lean_to_rich", "symmetric")
_STEPS, _SAMPLES = 32, 800  # worked on at once: as much as fits into the processor's cache


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


class BankState(NamedTuple):
    """The past of one signal, as far as the bank remembers it."""

    lags: FloatArray  # (n_slow,) what each lag reads
    past: FloatArray  # (n_past,) last values, the latest last


class Spans(NamedTuple):
    """Samples of signals side by side: those of span i come before those of span i + 1."""

    row: list[int]
    begin: list[int]
    end: list[int]


class Bank:
    """Runs every hypothesis on signals side by side.

    hypotheses : in the order of ``build``: healthy, slow, delay; within a kind by direction
    """

    def __init__(self, hypotheses: tuple[Hypothesis, ...], period_s: float) -> None:
        self.n_hypotheses = len(hypotheses)
        self._slow, slow = _places(hypotheses, "slow")
        first = self._slow.start
        self._share = np.array(
            [[1.0 - math.exp(-period_s / h.seconds)] for h in hypotheses[self._slow]]
        ).reshape(-1, 1)
        # the quick direction of a one-sided lag follows at once: the larger, or the smaller, step
        self._quick = [
            (function, slice(place.start - first, place.stop - first))
            for direction, function in (("rich_to_lean", np.maximum), ("lean_to_rich", np.minimum))
            if (place := slow.get(direction))
        ]
        _, self._late = _places(hypotheses, "delay")
        self._steps = {
            direction: np.array([round(h.seconds / period_s, 9) for h in hypotheses[place]])
            for direction, place in self._late.items()
        }
        self._whole = {d: steps.astype(np.int64) for d, steps in self._steps.items()}
        self._part = {d: steps - self._whole[d] for d, steps in self._steps.items()}
        self._interpolated = any(bool(part.any()) for part in self._part.values())
        self._shares: dict[int, FloatArray] = {}  # of a step that a lag goes, by rows
        self._key = {direction: steps.tobytes() for direction, steps in self._steps.items()}
        self._n_past = max((int(whole.max()) for whole in self._whole.values()), default=0) + 1

    def begin(self, value: float) -> BankState:
        """Return the state of a signal that has always been ``value``."""
        return BankState(np.full(len(self._share), value), np.full(self._n_past, value))

    def push(
        self, values: FloatArray, lengths: Sequence[int], states: Sequence[BankState], spans: Spans
    ) -> tuple[FloatArray, list[BankState]]:
        """Return the readings in spans, (m, n_hypotheses), and the signals' states at their ends.

        values : (rows, length) signals
        lengths : of the signals, never increasing; spans lie before them
        """
        past = np.array([state.past for state in states])
        signals = np.concatenate([past, values], axis=1)
        read = np.empty((sum(spans.end) - sum(spans.begin), self.n_hypotheses))
        self._read_late(read, signals, spans)
        lags = self._read_slow(read, values, lengths, states, spans)
        rows = zip(lengths, signals, lags, strict=True)
        return read, [BankState(x, row[n : n + self._n_past].copy()) for n, row, x in rows]

    def _read_late(self, read: FloatArray, signals: FloatArray, spans: Spans) -> None:
        if not len(read):
            return
        width, flat = signals.shape[1], signals.ravel()
        first = [row * width + self._n_past for row in spans.row]
        places = [np.arange(i + a, i + b) for i, a, b in zip(first, *spans[1:], strict=True)]
        at = places[0] if len(places) == 1 else np.concatenate(places)
        for begin in range(0, len(read), _SAMPLES):
            part = slice(begin, begin + _SAMPLES)
            self._read_late_part(read[part], flat, at[part, np.newaxis])

    def _read_late_part(self, read: FloatArray, flat: FloatArray, at: IntArray) -> None:
        now = flat.take(at)
        read[:, :1] = now
        known: dict[bytes, FloatArray] = {}
        for direction, place in self._late.items():
            key = self._key[direction]
            late = known.get(key)
            if late is None:
                late = known[key] = self._delayed(flat, at, direction)
            # a one-sided dead time holds the old value only against its own edge direction
            if direction == "symmetric":
                read[:, place] = late
            elif direction == "rich_to_lean":
                np.maximum(late, now, out=read[:, place])
            else:
                np.minimum(late, now, out=read[:, place])

    def _delayed(self, flat: FloatArray, at: IntArray, direction: str) -> FloatArray:
        """Return the signal as many steps before each sample as each dead time says."""
        before, part = at - self._whole[direction], self._part[direction]
        late: FloatArray = flat.take(before)
        if self._interpolated:
            late *= 1.0 - part
            late += flat.take(before - 1) * part
        return late

    def _read_slow(
        self,
        read: FloatArray,
        values: FloatArray,
        lengths: Sequence[int],
        states: Sequence[BankState],
        spans: Spans,
    ) -> list[FloatArray]:
        """Fill in the lags' readings; return each lag's reading at the end of each signal."""
        x = np.array([state.lags for state in states]).T  # (n_slow, rows)
        found = [state.lags for state in states]
        at = 0
        rest = []
        for row, begin, end in zip(*spans, strict=True):
            rest.append((row, begin, end, read[at : (at := at + end - begin), self._slow]))
        for low, high, rows in phases(lengths):
            for first in range(low, high, _STEPS):
                stop = min(first + _STEPS, high)
                seen = self._run_slow(x[:, :rows].copy(), values[:rows, first:stop])
                x = seen[-1]
                by_row = seen.transpose(2, 0, 1)
                if rows > 1:
                    by_row = by_row.copy()  # so that a sample's values lie together
                for row, begin, end, target in rest:
                    if begin < stop and end > first:
                        a, b = max(begin, first), min(end, stop)
                        target[a - begin : b - begin] = by_row[row, a - first : b - first]
                for row in range(rows):
                    if first < lengths[row] <= stop:
                        found[row] = by_row[row, lengths[row] - 1 - first].copy()
        return found

    def _run_slow(self, x: FloatArray, values: FloatArray) -> FloatArray:
        """Return the lags' readings of (rows, n) values, (n, n_slow, rows); x : before them."""
        seen = np.empty((values.shape[1], *x.shape))
        fall, share = np.empty_like(x), self._shares.get(x.shape[1])
        if share is None:
            share = self._shares[x.shape[1]] = np.repeat(self._share, x.shape[1], axis=1)
        quick = [(function, fall[place], place) for function, place in self._quick]
        for now, step in zip(values.T.copy(), seen, strict=True):
            np.subtract(now, x, fall)
            np.multiply(fall, share, step)
            for function, way, place in quick:
                sided = step[place]
                function(way, sided, out=sided)
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
