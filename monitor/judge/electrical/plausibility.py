"""Tests of each sample that need no model: the signal is missing, implausible or not ready.

A sensor that is not heated reads a constant. Where no signal says whether it is ready, nobody knows
whether it is cold or dead until its reading has moved since the engine's start.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from monitor.base.config import PlausibilityConfig
from monitor.base.runs import alike
from monitor.base.types import BoolArray, FloatArray, Quality, QualityArray

DUTY, ENGINE, READY = "sensor_heater_percent", "engine_speed_rpm", "sensor_ready"
_UNKNOWN, _NO, _, _YES = range(4)  # of a signal: it is not valid, below its threshold, above it
_REGULATED, _FULL = 1, 3  # of a heater's duty: below full duty, at it; else not valid or off


class TickResult(NamedTuple):
    """One result of one test on one sample."""

    test: str  # "communication", "ready", "range", "response" or "activity"
    failed: bool
    fault: str


class Results(NamedTuple):
    """The same result of one test on some samples in a row."""

    begin: int
    end: int
    result: TickResult


class Readiness:
    """Finds from which sample on a sensor counts as ready.

    names : signals of a sample; with ``sensor_ready`` among them that signal decides, not the
        reading. Without the engine's speed the engine may stand, so a reading that has not moved
        for ``first_move_s`` is left to the test of a frozen signal.
    """

    def __init__(self, config: PlausibilityConfig, names: Sequence[str], period_s: float) -> None:
        self._is_told, self._knows_engine = READY in names, ENGINE in names
        self._least, self._patience = config.stuck_range, round(config.first_move_s / period_s)
        self.reset()

    def reset(self) -> None:
        """Start as after switching on."""
        self._low, self._high = math.inf, -math.inf
        self._waited = 0

    def push(self, measured: FloatArray, good: BoolArray, running: BoolArray) -> BoolArray:
        """Return whether the sensor counts as ready, (n,).

        good : (n,) whether the reading is valid and not pinned at an end of its range
        running : (n,) whether the engine runs
        """
        ready = np.ones(len(measured), dtype=np.bool_)
        if self._is_told:
            return ready
        for begin, end, is_running in alike(running):
            if not is_running:
                self.reset()
            elif self._high - self._low <= self._least:
                ready[begin:end] = self._moved(measured[begin:end], good[begin:end])
        return ready

    def _moved(self, measured: FloatArray, good: BoolArray) -> BoolArray:
        """Take samples with a running engine, the reading not moved before."""
        low = np.minimum(np.minimum.accumulate(np.where(good, measured, np.inf)), self._low)
        high = np.maximum(np.maximum.accumulate(np.where(good, measured, -np.inf)), self._high)
        self._low, self._high = low[-1].item(), high[-1].item()
        moved = high - low > self._least
        if not self._knows_engine:
            moved |= self._waited + np.arange(1, len(measured) + 1) > self._patience
            self._waited += len(measured)
        return np.asarray(moved)


class Plausibility:
    """Judges the quality of the measured signal, one run of alike samples after the other.

    An ECU heats a cold sensor at full duty and regulates it from then on. Where the duty was
    regulated and is full again for long, the heater gives less than it should.

    names : signals of a sample
    output : name of the measured signal among them
    is_expected : whether the sender is known, so that its silence from the start is a fault
    """

    def __init__(
        self,
        config: PlausibilityConfig,
        names: Sequence[str],
        output: str,
        period_s: float,
        *,
        is_expected: bool = True,
    ) -> None:
        at = {name: i for i, name in enumerate(names)}
        self._output, self._ready, self._speed = at[output], at.get(READY), at.get(ENGINE)
        self._running_rpm = config.engine_running_rpm
        # two bits each for what readiness, engine speed and the heater's duty say; those of a
        # signal which is not provided stay _UNKNOWN
        above_zero = math.nextafter(0.0, 1.0)
        told = (
            (self._ready, -math.inf, above_zero),
            (self._speed, -math.inf, config.engine_running_rpm),
            (at.get(DUTY), above_zero, config.heater_full_percent),
        )
        self._places = [place or 0 for place, *_ in told for _ in range(2)]
        self._least = np.array(
            [math.nan if place is None else bound for place, *bounds in told for bound in bounds]
        )
        patience_s = config.first_move_s if self._ready is None else config.not_ready_s
        seconds = config.heater_full_s, config.heater_regulated_s, patience_s
        self._most_full, self._least_regulated, self._patience, self._start_patience = (
            round(s / period_s) for s in (*seconds, config.start_patience_s)
        )
        self.is_expected, self._heard = is_expected, False
        self.reset()

    def reset(self) -> None:
        """Start as after switching on."""
        self._full = self._regulated = 0  # samples at full duty in a row, and regulated in all
        self._not_ready = 0  # samples in a row with the engine running
        self._unheard = 0  # samples before the sender was heard for the first time
        self.is_expected |= self._heard
        self._heard = False
        self._stood = False  # the engine stood when its speed was last known

    def push(
        self, values: FloatArray, quality: QualityArray, ready: BoolArray | None = None
    ) -> list[Results]:
        """Return the results that samples allow, test by test within each run of alike ones.

        values, quality : (n, n_names)
        ready : (n,) whether the sensor is ready, where no signal says so
        """
        reached = values.take(self._places, axis=1) >= self._least
        masks = np.packbits(reached, axis=1, bitorder="little")[:, 0]
        if self._ready is None and ready is not None:
            masks[~ready] |= _NO
        codes = np.multiply(masks, len(Quality), dtype=np.uint16)
        codes += quality[:, self._output]
        found: list[Results] = []
        for begin, end, each in alike(codes):
            rest, q = divmod(each, len(Quality))
            own = self._run(begin, end, q, told=rest & 3, engine=rest >> 2 & 3, duty=rest >> 4)
            found += [Results(a, b, TickResult(*result)) for a, b, result in own if a < b]
        return found

    def _run(
        self, begin: int, end: int, quality: int, *, told: int, engine: int, duty: int
    ) -> Iterator[tuple[int, int, tuple[str, bool, str]]]:
        """Yield samples of a run, which may be none, with a test, whether it failed, and its fault.

        told, engine, duty : what ``sensor_ready``, the engine's speed and the heater's duty say
        """
        if quality == Quality.GAP:  # nobody knows how long it was, and whether the signal came
            self._not_ready = 0
            return
        blank, silent = quality == Quality.INVALID, quality in (Quality.STALE, Quality.OFF_BUS)
        ready = not blank if told == _UNKNOWN else told == _YES
        gone = self._ready is not None and told == _UNKNOWN
        # a blank in a table reads as invalid; with the readiness blank, too, nothing came
        missing = silent or (blank and gone)
        if engine != _UNKNOWN:
            self._stood = engine == _NO
        self._heard = self._heard or not missing
        first = begin
        if not self._heard:  # an ECU that was never heard may still be starting
            patience = self._start_patience - self._unheard if self.is_expected else end
            first += max(patience, 0)
            self._unheard += end - begin
        # with the ignition off an ECU falls silent, which is no fault
        if quality == Quality.OFF_BUS:
            yield first, end, ("communication", True, "bus_off")
        elif not (missing and self._stood):
            fault = "signal_invalid" if blank and ready else "signal_missing"
            yield first, end, ("communication", missing or (blank and ready), fault)
        runs = self._speed is None or engine == _YES
        cold = end - self._count_full(duty if runs else _UNKNOWN, end - begin)
        if not ready and not gone and runs:
            first = begin + max(self._patience - self._not_ready, 0)
            self._not_ready += end - begin
            yield first, end, ("ready", True, "heater" if duty == _FULL else "not_ready")
        else:
            self._not_ready = 0
            if ready and not missing:  # else it is not known yet
                yield begin, cold, ("ready", False, "not_ready")
                yield cold, end, ("ready", True, "heater")
        if ready and quality in (Quality.GOOD, Quality.PINNED, Quality.OUT_OF_RANGE):
            yield begin, end, ("range", quality == Quality.OUT_OF_RANGE, "out_of_range")

    def _count_full(self, duty: int, count: int) -> int:
        """Take samples with one duty; return how many, the last ones, tell of a faulty heater."""
        if duty != _FULL:
            self._full = 0
            self._regulated += count * (duty == _REGULATED)
            return 0
        self._full += count
        if self._regulated < self._least_regulated:
            return 0
        return min(max(self._full - self._most_full, 0), count)

    def running(self, values: FloatArray) -> BoolArray:
        """Return whether the engine runs, (n,); without its speed it does."""
        if self._speed is None:
            return np.ones(len(values), dtype=np.bool_)
        return values[:, self._speed] >= self._running_rpm
