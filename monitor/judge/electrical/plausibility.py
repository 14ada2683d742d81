"""Tests that need no model: the signal is missing, implausible, not ready or frozen."""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from monitor.base.config import PlausibilityConfig
from monitor.base.runs import alike
from monitor.base.types import BoolArray, FloatArray, Quality, QualityArray
from monitor.judge.electrical.readiness import DUTY, ENGINE, READY
from monitor.model.card import Channel

STRETCHES_OF_A_CODE: Final = 2  # in which the reading stands still; see response_fail
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


class Maturing:
    """Finds the samples at which so many alike results of a test in a row mature.

    failed, passed : how many failed, and how many passed, results mature
    """

    def __init__(self, failed: int, passed: int) -> None:
        self._needed = {True: failed, False: passed}
        self.reset()

    def reset(self) -> None:
        """Begin every row anew."""
        self._rows: dict[str, tuple[bool, int]] = {}  # failed, and how many in a row

    def push(self, results: Sequence[Results]) -> list[tuple[int, TickResult]]:
        """Return sample and result where a row matures; rows go on from block to block."""
        found = []
        for begin, end, result in results:
            failed, count = self._rows.get(result.test, (result.failed, 0))
            count = count if failed is result.failed else 0
            needed = self._needed[result.failed]
            if count < needed <= count + end - begin:
                found.append((begin + needed - count - 1, result))
            self._rows[result.test] = result.failed, count + end - begin
        return found


class ActivityTest:
    """Finds a frozen signal: no change over so many samples though the engine burns fuel.

    Where nothing says whether the fuel is cut, a sensor may stand still at the highest output that
    training saw for as long as a fuel cut lasts. Where nothing says whether the engine runs, a
    healthy sensor may stand still at its lowest reading, heater and engine off, if it dwelt there
    in training.

    output : of the model; names : of the signals of a sample
    still_s : time for which this car's healthy reading may stand still, if longer than usual
    still_end_s : the same at the highest output
    """

    def __init__(
        self,
        config: PlausibilityConfig,
        output: Channel,
        names: Sequence[str],
        period_s: float,
        still_s: float = 0.0,
        still_end_s: float = 0.0,
    ) -> None:
        self._config = config
        dwelt = output.percentile_0_1 - output.minimum <= config.stuck_range
        self._cold = output.minimum if dwelt and not {ENGINE, READY} & set(names) else -math.inf
        self._saturated = math.inf if "fuel_cut" in names else output.maximum
        self._n = max(round(max(config.stuck_s, still_s / STRETCHES_OF_A_CODE) / period_s), 2)
        rest_s = max(config.fuel_cut_most_s, still_end_s)
        self._cuts = math.ceil(rest_s / (self._n * period_s))
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self._begin()
        self._rested = 0  # stretches in a row at the end of the range

    def _begin(self) -> None:
        self._count = 0
        self._low, self._high = math.inf, -math.inf

    def push(self, measured: FloatArray, active: BoolArray) -> list[tuple[int, TickResult]]:
        """Return every stretch that is judged, with its last sample.

        measured : (n,)
        active : (n,) whether the signal must move; any other sample does not count, and begins a
            stretch anew if the reading moves there
        """
        found = []
        for first, end, is_active in alike(active):
            if not is_active:
                self._wait(measured[first:end])
                continue
            edges = [first, *range(first + self._n - self._count, end, self._n), end]
            for begin, stop in pairwise(edges):
                self._see(measured[begin:stop])
                self._count += stop - begin
                if self._count == self._n:
                    judged = self._judged(measured.item(stop - 1))
                    self._begin()
                    if judged is not None:
                        found.append((stop - 1, judged))
        return found

    def _wait(self, measured: FloatArray) -> None:
        """Take readings that need not move."""
        if self._count:
            self._see(measured)
            if not self._is_frozen:
                self.reset()

    def _see(self, measured: FloatArray) -> None:
        self._low = np.minimum(self._low, np.minimum.reduce(measured)).item()  # NaN is kept
        self._high = np.maximum(self._high, np.maximum.reduce(measured)).item()

    @property
    def _is_frozen(self) -> bool:
        return self._high - self._low <= self._config.stuck_range

    def is_cold(self, reading: float) -> bool:
        """Return whether a healthy sensor that is not heated yet may read so."""
        return reading <= self._cold + self._config.stuck_range

    def is_at_end(self, reading: float) -> bool:
        """Return whether a healthy sensor may read so in a fuel cut that no signal tells."""
        return reading >= self._saturated

    def _judged(self, last: float) -> TickResult | None:
        frozen = self._is_frozen
        if frozen and self.is_cold(last):
            return None
        self._rested = self._rested + 1 if frozen and self.is_at_end(last) else 0
        if 0 < self._rested <= self._cuts:
            return None
        fault = "stuck_lean" if last > 1.0 else "stuck_rich"
        if abs(last - 1.0) <= self._config.stuck_band_at_one:
            fault = "stuck_at_one"
        return TickResult("activity", frozen, fault)
