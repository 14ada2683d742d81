"""Suspension of the machine: a time in which nobody listened to the bus.

Linux stops CLOCK_MONOTONIC while a machine is suspended; CLOCK_BOOTTIME goes on (clock_gettime(2)).
The loop measures time by the latter, so bus time agrees with the interface's stamps after a
suspension; the difference between the two says how long the machine slept. The bus may have been
alive meanwhile, so the time is a gap, not a silence.
"""

import time
from collections.abc import Callable
from typing import Final

LEAST_S: Final = 0.3  # the two clocks are read one after the other; a shorter sleep is no matter
_BOOT: Final[int | None] = getattr(time, "CLOCK_BOOTTIME", None)  # Linux alone


def passed_s() -> float:
    """Return a monotonic time in s that goes on while the machine is suspended."""
    return time.monotonic() if _BOOT is None else time.clock_gettime(_BOOT)


def slept_s() -> float:
    """Return for how many s the machine has been suspended since it was started."""
    return passed_s() - time.monotonic()


class Suspension:
    """Notices that the machine was suspended.

    slept_s : for how many s in all
    """

    def __init__(self, slept_s: Callable[[], float] = slept_s) -> None:
        self._slept_s = slept_s
        self._known_s = slept_s()

    def has_ended(self) -> bool:
        """Return whether the machine was suspended since the last call."""
        # a pause between its two looks at the clocks makes it less, never more
        before_s, self._known_s = self._known_s, max(self._known_s, self._slept_s())
        return self._known_s - before_s >= LEAST_S
