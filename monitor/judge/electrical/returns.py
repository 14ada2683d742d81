"""A reading that jumps to one value again and again, stays exactly there and jumps away.

A live sensor has a lag and noise: it neither arrives at a value at once nor rests on it, and its
next rest is elsewhere. A loose contact or a controller's default value does all three. Visits to
one value count against visits to others, so that only a value that has the majority of them stands
out (Boyer and Moore, MJRTY, a fast majority vote algorithm, 1981).
"""

import math
from typing import Final

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
