"""The tests of the measured signal that need no model, on blocks of samples.

The signal is missing, invalid, out of range, not ready, frozen, or jumps to one value.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from monitor.base.config import Config, PlausibilityConfig
from monitor.base.runs import alike
from monitor.base.types import BoolArray, FloatArray, Quality, QualityArray
from monitor.judge.counters import ticks_to_mature
from monitor.judge.electrical.plausibility import (
    ENGINE,
    READY,
    Plausibility,
    Readiness,
    Results,
    TickResult,
)
from monitor.judge.limits import Limits
from monitor.model.card import Channel

LEAST: Final = 3  # equal readings of a visit; two may be chance
RETURNS: Final = TickResult("response", True, "intermittent")


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
    """

    def __init__(
        self, config: PlausibilityConfig, output: Channel, names: Sequence[str], period_s: float
    ) -> None:
        self._config = config
        dwelt = output.percentile_0_1 - output.minimum <= config.stuck_range
        self._cold = output.minimum if dwelt and not {ENGINE, READY} & set(names) else -math.inf
        self._saturated = math.inf if "fuel_cut" in names else output.maximum
        self._n = max(round(config.stuck_s / period_s), 2)
        self._cuts = math.ceil(config.fuel_cut_most_s / (self._n * period_s))
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
                if self._count:
                    self._see(measured[first:end])
                    if not self._is_frozen:
                        self.reset()
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


class ReturnTest:
    """Finds a reading that jumps to one value again and again, stays exactly there and jumps away.

    A live sensor has a lag and noise: it neither arrives at a value at once nor rests on it, and
    its next rest is elsewhere. A loose contact or a controller's default value does all three.
    Visits to one value count against visits to others, so that only a value that has the majority
    of them stands out (Boyer and Moore, MJRTY, a fast majority vote algorithm, 1981).

    jump : least step with which a visit begins and ends, output's unit
    needed : visits, more than to all other values, that decide
    """

    def __init__(self, jump: float, needed: int) -> None:
        self._jump, self._needed = jump, needed
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self._last, self._burning = math.nan, False
        self._length, self._entry = 0, math.nan  # of the readings like the last one
        self._value, self._visits = math.nan, 0

    def push(self, measured: FloatArray, burning: BoolArray) -> list[int]:
        """Return the samples with which the visits to one value decide.

        measured : (n,) the reading, NaN while the sensor sleeps
        burning : (n,) whether fuel surely burns; else a healthy reading, too, may jump to the value
            of air, the leanest, and back
        """
        found, last, burnt, jump = [], self._last, self._burning, self._jump
        length, entry = self._length, self._entry
        for k, (now, burns) in enumerate(zip(measured.tolist(), burning.tolist(), strict=True)):
            if now != last:
                step = now - last
                is_visit = length >= LEAST and abs(entry) >= jump and abs(step) >= jump
                if is_visit and (burnt or not entry > 0.0 > step) and self._decides(last):
                    found.append(k)
                length, entry = 0, step
            length += 1
            last, burnt = now, burns
        self._last, self._burning, self._length, self._entry = last, burnt, length, entry
        return found

    def _decides(self, value: float) -> bool:
        """Take a visit; return whether it is the one that decides."""
        if value != self._value and self._visits:
            self._visits -= 1
            return False
        self._value, self._visits = value, min(self._visits + 1, self._needed + 1)
        return self._visits == self._needed


class ElectricalTests:
    """The tests of one sensor.

    names : signals of a sample
    output : the measured signal among them, with its range in training
    limits : of the car's model, with the noise, beyond which a step of the reading is a jump
    is_expected : whether the sender is known, so that its silence from the start is a fault
    """

    def __init__(
        self,
        config: Config,
        names: Sequence[str],
        output: Channel,
        period_s: float,
        limits: Limits | None = None,
        *,
        is_expected: bool = True,
    ) -> None:
        own = config.plausibility
        noise = limits.noise if limits else 0.0
        self._output = names.index(output.name)
        self._readiness = Readiness(own, names, period_s)
        self.plausibility = Plausibility(own, names, output.name, period_s, is_expected=is_expected)
        self._maturing = Maturing(*ticks_to_mature(config.debounce, period_s))
        self._activity = ActivityTest(own, output, names, period_s)
        self._returns = ReturnTest(max(noise, own.stuck_band_at_one), own.visits)
        self._knows_cuts = "fuel_cut" in names

    def reset(self) -> None:
        """Start as after switching on."""
        tests = self._readiness, self.plausibility, self._maturing, self._activity, self._returns
        for each in tests:
            each.reset()

    def forget(self) -> None:
        """Find anew what goes on, after a tester has cleared the codes."""
        self._maturing.reset()
        self._returns.reset()

    def push(
        self, values: FloatArray, quality: QualityArray, burning: BoolArray
    ) -> tuple[list[tuple[int, TickResult]], BoolArray, BoolArray]:
        """Return the results that count, each with its sample.

        The others are (n,): whether the engine runs, and whether a live sensor must move.

        values, quality : (n, n_names)
        burning : (n,) whether a live sensor moves while the engine runs
        Of alike results in a row the one counts with which they are enough; of the activity test
        each.
        """
        measured, running = values[:, self._output], self.plausibility.running(values)
        good = quality[:, self._output] == Quality.GOOD
        ready = self._readiness.push(measured, good, running)
        awake = running & ready
        active = awake & burning
        found = self._maturing.push(self.plausibility.push(values, quality, ready))
        seen = np.where(awake, measured, np.nan)
        found += [(k, RETURNS) for k in self._returns.push(seen, burning & self._knows_cuts)]
        return found + self._activity.push(measured, active), running, active
