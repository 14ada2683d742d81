"""Service $06: the latest test results with their limits, in the units of SAE J1979."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from monitor.memory.obd_records import TestResult


@dataclass(frozen=True, slots=True)
class Scaling:
    """One unit-and-scaling identifier of SAE J1979, annex E: a quantity in two bytes."""

    number: int
    step: float  # in the quantity's unit
    is_signed: bool = False

    def encode(self, value: float) -> bytes:
        """Return the value in two bytes, limited to the range."""
        low, high = (-0x8000, 0x7FFF) if self.is_signed else (0, 0xFFFF)
        held = min(max(value, low * self.step), high * self.step)
        return round(held / self.step).to_bytes(2, "big", signed=self.is_signed)


MILLISECONDS: Final = Scaling(0x10, 0.001)
RATIO: Final = Scaling(0x20, 1.0 / 256.0)
FINE_SIGNED: Final = Scaling(0x85, 1.0 / 32768.0, is_signed=True)  # -1 to 1

# (test, quantity) → test identifier, scaling; $80 to $FE are free for the manufacturer.
TESTS: Final = {
    ("response", "lag_rich_to_lean_s"): (0x80, MILLISECONDS),
    ("response", "lag_lean_to_rich_s"): (0x81, MILLISECONDS),
    ("response", "dead_time_rich_to_lean_s"): (0x82, MILLISECONDS),
    ("response", "dead_time_lean_to_rich_s"): (0x83, MILLISECONDS),
    ("response", "gain"): (0x84, RATIO),
    ("bias", "offset"): (0x85, FINE_SIGNED),
}


def test_results(monitor_id: int, results: Iterable[TestResult]) -> list[bytes]:
    """Return nine bytes per test: identifiers, value and limits; zeros if it has not run."""
    latest = {(r.test, r.quantity): r for r in results}
    rows = []
    for key, (test_id, scaling) in TESTS.items():
        result = latest.get(key)
        numbers = (result.value, result.low, result.high) if result else (0.0, 0.0, 0.0)
        head = bytes((monitor_id, test_id, scaling.number))
        rows.append(head + b"".join(map(scaling.encode, numbers)))
    return rows
