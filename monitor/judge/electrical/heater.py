"""Whether a sensor's heater reaches its aim, told by its duty.

An ECU heats a cold sensor at full duty and regulates it from then on. Where the duty was regulated
and is full again for long, the heater gives less than it should.
"""

from typing import Final

DUTY: Final = "sensor_heater_percent"
UNKNOWN, REGULATED, _, FULL = range(4)  # of a duty: not valid or off, below full duty, at it


class Heater:
    """Counts samples with the engine running, in runs with the same duty.

    full : samples in a row at full duty, after it was regulated, that tell of a fault
    regulated : samples of a regulated duty after which it counts as regulated
    """

    def __init__(self, full: int, regulated: int) -> None:
        self._full_needed, self._regulated_needed = full, regulated
        self.reset()

    def reset(self) -> None:
        """Begin as after switching on."""
        self._full = self._regulated = 0

    def push(self, duty: int, count: int) -> int:
        """Take samples with the same duty; return how many of them, the last ones, tell of a fault.

        duty : UNKNOWN, REGULATED or FULL
        """
        if duty != FULL:
            self._full = 0
            self._regulated += count * (duty == REGULATED)
            return 0
        self._full += count
        if self._regulated < self._regulated_needed:
            return 0
        return min(max(self._full - self._full_needed, 0), count)
