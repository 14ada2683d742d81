"""A reading that jumps to one value again and again, stays exactly there and jumps away.

A live sensor has a lag and noise: it neither arrives at a value at once nor rests on it, and its
next rest is elsewhere. A loose contact or a controller's default value does all three. Visits to
one value count against visits to others, so that only a value that has the majority of them stands
out (Boyer and Moore, MJRTY, a fast majority vote algorithm, 1981).
"""

import math
from typing import Final

import numpy as np

from monitor.base.types import BoolArray, FloatArray

LEAST: Final = 3  # equal readings of a visit; two may be chance


class ReturnTest:
    """Counts visits to one value, constant memory; blocks may be of any length.

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
        before = np.append(self._last, measured[:-1])
        ends = np.flatnonzero(measured != before)  # the first sample after each rest
        steps = measured[ends] - before[ends]
        lengths = np.diff(ends, prepend=-self._length)
        entries = np.append(self._entry, steps)[: len(ends)]
        may_be_air = (entries > 0.0) & (steps < 0.0) & ~np.append(self._burning, burning)[ends]
        visits = np.minimum(np.abs(entries), np.abs(steps)) >= self._jump
        visits &= (lengths >= LEAST) & ~may_be_air
        found = [k for k in ends[visits].tolist() if self._decides(before.item(k))]
        self._last, self._burning = measured.item(-1), bool(burning[-1])
        self._length += len(measured)
        if len(ends):
            self._length, self._entry = len(measured) - ends.item(-1), steps.item(-1)
        return found

    def _decides(self, value: float) -> bool:
        """Take a visit; return whether it is the one that decides."""
        if value != self._value and self._visits:
            self._visits -= 1
            return False
        self._value, self._visits = value, min(self._visits + 1, self._needed + 1)
        return self._visits == self._needed
