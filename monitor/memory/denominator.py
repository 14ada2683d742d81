"""The general denominator of a driving cycle: long enough, fast enough, and one idle."""

import math

import numpy as np

from monitor.base.config import CyclesConfig
from monitor.base.types import BoolArray, FloatArray, IntArray


class Denominator:
    """The general denominator of one driving cycle: long enough, fast enough, and one idle."""

    def __init__(self, config: CyclesConfig) -> None:
        self._config = config
        self._run_ns = self._moving_ns = self._idle_ns = 0
        self._has_idled = False

    def interrupt(self) -> None:
        """End the idling."""
        self._idle_ns = 0

    def push(
        self, steps_ns: IntArray, fits: BoolArray, speed_km_h: FloatArray | None
    ) -> int | None:
        """Take samples in which the engine runs, each array (n,); return where all is reached.

        fits : neither too cold nor too high
        speed_km_h : without it the vehicle neither moves nor idles
        """
        config, speed = self._config, np.nan if speed_km_h is None else speed_km_h
        moves = fits & (speed >= config.denominator_moving_km_h)
        idles = fits & (speed <= config.denominator_idle_km_h)
        run_ns = self._run_ns + np.cumsum(steps_ns * fits)
        moving_ns = self._moving_ns + np.cumsum(steps_ns * moves)
        total_ns = np.cumsum(steps_ns * idles)
        idle_ns = total_ns - np.maximum.accumulate(np.where(idles, -self._idle_ns, total_ns))
        idled = np.logical_or.accumulate(idle_ns >= whole_ns(config.denominator_idle_s))
        idled |= self._has_idled
        self._run_ns, self._moving_ns = run_ns.item(-1), moving_ns.item(-1)
        self._idle_ns, self._has_idled = idle_ns.item(-1), bool(idled[-1])
        is_long = run_ns >= whole_ns(config.denominator_run_s)
        return first_of(
            fits & is_long & (moving_ns >= whole_ns(config.denominator_moving_s)) & idled
        )


def first_of(holds: BoolArray) -> int | None:
    """Return the number of the first sample at which something holds, None if it never does."""
    at = int(holds.argmax())
    return at if holds[at] else None


def whole_ns(seconds: float) -> int:
    """Return whole nanoseconds; as many as no drive has for an infinite time."""
    return round(seconds * 1e9) if math.isfinite(seconds) else 1 << 62
