"""Fault detection counter: single results add up to a test result."""

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
        """Return the counter after one more result, which counts ``by`` steps.

        A result against the counter's sign first sets it to zero, so a long healthy time does not
        slow down the detection.
        """
        if failed:
            return Debounce(min(max(self.count, 0) + by, FAILED))
        return Debounce(max(min(self.count, 0) - by, PASSED))

    @property
    def failed(self) -> bool:
        """Return True if the test has failed: the counter is at +127."""
        return self.count == FAILED

    @property
    def passed(self) -> bool:
        """Return True if the test has passed: the counter is at -128."""
        return self.count == PASSED
