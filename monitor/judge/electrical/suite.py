"""The tests of the measured signal that need no model, on blocks of samples.

The signal is missing, invalid, out of range, not ready, frozen, or jumps to one value.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from monitor.base.config import Config
from monitor.base.types import BoolArray, FloatArray, Quality, QualityArray
from monitor.judge.counters import ticks_to_mature
from monitor.judge.electrical.plausibility import ActivityTest, Maturing, Plausibility, TickResult
from monitor.judge.electrical.readiness import Readiness
from monitor.judge.electrical.returns import ReturnTest
from monitor.judge.limits import Limits
from monitor.model.card import Channel

RETURNS: Final = TickResult("response", True, "intermittent")


class ElectricalTests:
    """The tests of one sensor.

    names : signals of a sample
    output : the measured signal among them, with its range in training
    limits : of the car's model, with the times for which a healthy reading may stand still, and the
        noise, beyond which a step of the reading is a jump
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
        noise, *still_s = (limits.noise, limits.still_s, limits.still_end_s) if limits else (0.0,)
        self._output = names.index(output.name)
        self._readiness = Readiness(own, names, period_s)
        self.plausibility = Plausibility(own, names, output.name, period_s, is_expected=is_expected)
        self._maturing = Maturing(*ticks_to_mature(config.debounce, period_s))
        self._activity = ActivityTest(own, output, names, period_s, *still_s)
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
    ) -> tuple[list[tuple[int, TickResult]], BoolArray]:
        """Return the results that count, each with its sample, and whether the engine runs, (n,).

        values, quality : (n, n_names)
        burning : (n,) whether a live sensor moves while the engine runs
        Of alike results in a row the one counts with which they are enough; of the activity test
        each.
        """
        running, ready = self._awake(values, quality)
        measured, awake = values[:, self._output], running & ready
        found = self._maturing.push(self.plausibility.push(values, quality, ready))
        seen = np.where(awake, measured, np.nan)
        found += [(k, RETURNS) for k in self._returns.push(seen, burning & self._knows_cuts)]
        return found + self._activity.push(measured, awake & burning), running

    def must_move(self, values: FloatArray, quality: QualityArray, burning: BoolArray) -> BoolArray:
        """Return on which samples a live sensor moves, (n,); arguments as for ``push``."""
        running, ready = self._awake(values, quality)
        return running & burning & ready

    def _awake(self, values: FloatArray, quality: QualityArray) -> tuple[BoolArray, BoolArray]:
        """Return whether the engine runs and whether the sensor is ready, (n,) each."""
        running, good = self.plausibility.running(values), quality[:, self._output] == Quality.GOOD
        return running, self._readiness.push(values[:, self._output], good, running)
