"""Whether a sensor is ready, told by its reading where no signal says so.

A sensor that is not heated reads a constant. Until the reading has moved since the engine's start,
nobody knows whether it is cold or dead.
"""

import math
from collections.abc import Sequence

import numpy as np

from monitor.base.config import PlausibilityConfig
from monitor.base.runs import alike
from monitor.base.types import BoolArray, FloatArray

ENGINE, READY, DUTY = "engine_speed_rpm", "sensor_ready", "sensor_heater_percent"


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
