"""Fault detection counter: single results become a matured test result."""

from dataclasses import dataclass

FAILED, PASSED = 127, -128


@dataclass(frozen=True, slots=True)
class Debounce:
    """Fault detection counter of ISO 14229-1: -128 passed, +127 failed.

    >>> Debounce().step(failed=True, by=64).step(failed=True, by=64).failed
    True
    """

    count: int = 0

    def step(self, *, failed: bool, by: int) -> "Debounce":
        """Return the counter after one more result.

        A result against the counter's sign starts from zero, so that a long healthy time does
        not slow the detection down.
        """
        if failed:
            return Debounce(min(max(self.count, 0) + by, FAILED))
        return Debounce(max(min(self.count, 0) - by, PASSED))

    @property
    def failed(self) -> bool:
        """True when the fault has matured."""
        return self.count == FAILED

    @property
    def passed(self) -> bool:
        """True when the test has completed without a fault."""
        return self.count == PASSED
