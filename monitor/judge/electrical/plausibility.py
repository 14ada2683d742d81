"""Tests that need no model: the signal is missing, implausible, not ready or frozen."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from monitor.base.config import PlausibilityConfig
from monitor.base.runs import Thresholds, alike
from monitor.base.types import BoolArray, FloatArray, Quality, QualityArray
from monitor.judge.electrical import heater
from monitor.judge.electrical.heater import Heater
from monitor.judge.electrical.readiness import ENGINE, READY
from monitor.model.card import Channel

_GOOD, _STALE, _INVALID, _OUT_OF_RANGE, _OFF_BUS, _PINNED, _GAP = (
    int(quality) for quality in Quality
)
_N_QUALITIES = len(Quality)
STRETCHES_OF_A_CODE: Final = 2  # in which the reading stands still; see response_fail
_UNKNOWN, _NO, _, _YES = range(4)  # of a signal: it is not valid, below its threshold, above it


@dataclass(frozen=True, slots=True)
class TickResult:
    """One result of one test on one sample."""

    test: str  # "communication", "ready" or "range"
    failed: bool
    fault: str


_HEARD = TickResult("communication", False, "signal_missing")
_MISSING = TickResult("communication", True, "signal_missing")
_NOT_VALID = TickResult("communication", True, "signal_invalid")
_BUS_OFF = TickResult("communication", True, "bus_off")
_READY, _NOT_READY = (TickResult("ready", failed, "not_ready") for failed in (False, True))
_NOT_HEATED = TickResult("ready", True, "heater")
_INSIDE, _OUTSIDE = (TickResult("range", failed, "out_of_range") for failed in (False, True))


class Results(NamedTuple):
    """The same result of one test on some samples in a row."""

    begin: int
    end: int
    result: TickResult


class Still(NamedTuple):
    """A judged stretch of the activity test."""

    failed: bool  # the reading was frozen
    fault: str


class Plausibility:
    """Judges the quality of the measured signal, one run of alike samples after the other.

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
        self._output = at[output]
        self._ready = at.get(READY)
        self._speed = at.get(ENGINE)
        self._running_rpm = config.engine_running_rpm
        # two bits each for what readiness, engine speed and the heater's duty say; those of a
        # signal which is not provided stay _UNKNOWN
        above_zero = math.nextafter(0.0, 1.0)
        told = (
            (self._ready, -math.inf, above_zero),
            (self._speed, -math.inf, config.engine_running_rpm),
            (at.get(heater.DUTY), above_zero, config.heater_full_percent),
        )
        self._told = Thresholds(
            [place or 0 for place, *_ in told for _ in range(2)],
            [math.nan if place is None else bound for place, *bounds in told for bound in bounds],
        )
        samples = [round(s / period_s) for s in (config.heater_full_s, config.heater_regulated_s)]
        self._heater = Heater(*samples)
        patience_s = config.first_move_s if self._ready is None else config.not_ready_s
        self._patience = round(patience_s / period_s)
        self._start_patience = round(config.start_patience_s / period_s)
        self.is_expected, self._heard = is_expected, False
        self.reset()

    def reset(self) -> None:
        """Start as after switching on."""
        self._heater.reset()
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
        masks = self._told.masks(values)
        if self._ready is None and ready is not None:
            masks[~ready] |= _NO
        codes = np.multiply(masks, _N_QUALITIES, dtype=np.uint16)
        codes += quality[:, self._output]
        found: list[Results] = []
        for begin, end, each in alike(codes):
            rest, q = divmod(each, _N_QUALITIES)
            rest, told = divmod(rest, 4)
            duty, engine = divmod(rest, 4)
            self._run(begin, end, found, quality=q, told=told, engine=engine, duty=duty)
        return found

    def _run(
        self,
        begin: int,
        end: int,
        found: list[Results],
        *,
        quality: int,
        told: int,
        engine: int,
        duty: int,
    ) -> None:
        """Add the results of samples that are alike.

        told, engine, duty : what ``sensor_ready``, the engine's speed and the heater's duty say
        """
        if quality == _GAP:  # nobody knows how long the log paused, and whether the signal came
            self._not_ready = 0
            return
        ready = quality != _INVALID if told == _UNKNOWN else told == _YES
        gone = self._ready is not None and told == _UNKNOWN
        # a blank in a table reads as invalid; with the readiness blank, too, nothing came
        missing = quality in (_STALE, _OFF_BUS) or (quality == _INVALID and gone)
        if engine != _UNKNOWN:
            self._stood = engine == _NO
        # with the ignition off an ECU falls silent, which is no fault
        asleep = missing and self._stood and quality != _OFF_BUS
        self._heard = self._heard or not missing
        first = begin
        if not self._heard:  # an ECU that was never heard may still be starting
            patience = self._start_patience - self._unheard if self.is_expected else end
            first += max(patience, 0)
            self._unheard += end - begin
        if first < end and not asleep:
            result = _MISSING if missing else _HEARD
            if quality == _OFF_BUS:
                result = _BUS_OFF
            elif quality == _INVALID and ready:
                result = _NOT_VALID
            found.append(Results(first, end, result))
        runs = self._speed is None or engine == _YES
        n_cold = self._heater.push(duty if runs else heater.UNKNOWN, end - begin)
        if not ready and not gone and runs:
            self._wait(begin, end, found, is_full=duty == heater.FULL)
        else:
            self._not_ready = 0
            if ready and not missing:  # else it is not known yet
                if begin < end - n_cold:
                    found.append(Results(begin, end - n_cold, _READY))
                if n_cold:
                    found.append(Results(end - n_cold, end, _NOT_HEATED))
        if ready and quality in (_GOOD, _PINNED, _OUT_OF_RANGE):
            found.append(Results(begin, end, _OUTSIDE if quality == _OUT_OF_RANGE else _INSIDE))

    def _wait(self, begin: int, end: int, found: list[Results], *, is_full: bool) -> None:
        """Take samples with a running engine and a sensor that is not ready."""
        first = begin + max(self._patience - self._not_ready, 0)
        self._not_ready += end - begin
        if first < end:
            found.append(Results(first, end, _NOT_HEATED if is_full else _NOT_READY))

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

    saturated : highest output that training saw; a sensor may stand still there for as long as a
        fuel cut lasts, if nothing says whether the fuel is cut
    cold : reading of a healthy sensor that is not heated yet, if it may be read unknowingly
    still_s : time for which this car's healthy reading may stand still, if longer than usual
    still_end_s : the same at ``saturated``
    """

    def __init__(
        self,
        config: PlausibilityConfig,
        saturated: float,
        period_s: float,
        cold: float = -math.inf,
        *,
        still_s: float = 0.0,
        still_end_s: float = 0.0,
    ) -> None:
        self._config = config
        self._saturated, self._cold = saturated, cold
        self._n = max(round(max(config.stuck_s, still_s / STRETCHES_OF_A_CODE) / period_s), 2)
        rest_s = max(config.fuel_cut_most_s, still_end_s)
        self._cuts = math.ceil(rest_s / (self._n * period_s))
        self.reset()

    @classmethod
    def of(
        cls,
        config: PlausibilityConfig,
        output: Channel,
        names: Sequence[str],
        period_s: float,
        still_s: float = 0.0,
        still_end_s: float = 0.0,
    ) -> "ActivityTest":
        """Return the test of a model's output on samples of ``names``.

        Where nothing says whether the engine runs, a healthy sensor may stand still at its lowest
        reading, heater and engine off, if it dwelt there in training.
        """
        dwelt = output.percentile_0_1 - output.minimum <= config.stuck_range
        cold = output.minimum if dwelt and not {ENGINE, READY} & set(names) else -math.inf
        saturated = math.inf if "fuel_cut" in names else output.maximum
        return cls(config, saturated, period_s, cold, still_s=still_s, still_end_s=still_end_s)

    def reset(self) -> None:
        """Begin anew."""
        self._begin()
        self._rested = 0  # stretches in a row at the end of the range

    def _begin(self) -> None:
        self._count = 0
        self._low, self._high = math.inf, -math.inf

    def push(self, measured: FloatArray, active: BoolArray) -> list[tuple[int, Still]]:
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
            begin = first
            while begin < end:
                stop = min(begin + self._n - self._count, end)
                self._see(measured[begin:stop])
                self._count += stop - begin
                begin = stop
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

    def _judged(self, last: float) -> Still | None:
        frozen = self._is_frozen
        if frozen and self.is_cold(last):
            return None
        self._rested = self._rested + 1 if frozen and self.is_at_end(last) else 0
        if 0 < self._rested <= self._cuts:
            return None
        return Still(frozen, self._name(last))

    def _name(self, measured: float) -> str:
        if abs(measured - 1.0) <= self._config.stuck_band_at_one:
            return "stuck_at_one"
        return "stuck_lean" if measured > 1.0 else "stuck_rich"
