"""Service $06: the latest test results with their limits, in the units of SAE J1979."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Final

from monitor.memory.obd_records import TestResult


@dataclass(frozen=True, slots=True)
class ResultScaling:
    """One unit-and-scaling identifier of SAE J1979, annex E: a quantity in two bytes."""

    number: int
    step: float  # in the quantity's unit
    is_signed: bool = False

    def encode(self, value: float) -> bytes:
        """Return the value in two bytes, limited to the range."""
        low, high = (-0x8000, 0x7FFF) if self.is_signed else (0, 0xFFFF)
        held = min(max(value, low * self.step), high * self.step)
        return round(held / self.step).to_bytes(2, "big", signed=self.is_signed)


MILLIVOLTS: Final = ResultScaling(0x0B, 0.001)
CENTIGRAMS: Final = ResultScaling(0x36, 0.01)
MILLISECONDS: Final = ResultScaling(0x10, 0.001)
RATIO: Final = ResultScaling(0x20, 1.0 / 256.0)
FINE_SIGNED: Final = ResultScaling(0x85, 1.0 / 32768.0, is_signed=True)  # -1 to 1

UPSTREAM, DOWNSTREAM, CATALYST, HEATER = 0x01, 0x02, 0x21, 0x42  # monitor identifiers of bank 1
# monitor → (test, quantity) → test identifier, scaling; $07 and $08 are the standard's lowest and
# highest voltage, $80 to $FE are free for the manufacturer.
TESTS: Final = {
    UPSTREAM: {
        ("response", "lag_rich_to_lean_s"): (0x80, MILLISECONDS),
        ("response", "lag_lean_to_rich_s"): (0x81, MILLISECONDS),
        ("response", "dead_time_rich_to_lean_s"): (0x82, MILLISECONDS),
        ("response", "dead_time_lean_to_rich_s"): (0x83, MILLISECONDS),
        ("response", "gain"): (0x84, RATIO),
        ("bias", "offset"): (0x85, FINE_SIGNED),
    },
    DOWNSTREAM: {
        ("downstream", "least_v"): (0x07, MILLIVOLTS),
        ("downstream", "most_v"): (0x08, MILLIVOLTS),
        ("downstream", "lag_rich_to_lean_s"): (0x80, MILLISECONDS),
        ("downstream", "lag_lean_to_rich_s"): (0x81, MILLISECONDS),
    },
    CATALYST: {
        ("catalyst", "capacity_g"): (0x80, CENTIGRAMS),
        ("catalyst", "capacity_over_threshold"): (0x81, RATIO),
        ("balance", "upstream_offset_phi"): (0x82, FINE_SIGNED),
    },
    HEATER: {("downstream_heater", "wake_s"): (0x80, MILLISECONDS)},
}
TEST_OF: Final = {
    UPSTREAM: "response",
    DOWNSTREAM: "downstream",
    CATALYST: "catalyst",
    HEATER: "downstream_heater",
}


def monitors(tests: Collection[str]) -> set[int]:
    """Return the monitors that this vehicle supports, by the tests that it does."""
    return {number for number, test in TEST_OF.items() if test in tests}


def test_results(monitor_id: int, results: Iterable[TestResult]) -> list[bytes]:
    """Return nine bytes per test: identifiers, value and limits; zeros if it has not run.

    Raises KeyError if there is no such monitor.
    """
    latest = {(r.test, r.quantity): r for r in results}
    rows = []
    for key, (test_id, scaling) in TESTS[monitor_id].items():
        result = latest.get(key)
        numbers = (result.value, result.low, result.high) if result else (0.0, 0.0, 0.0)
        head = bytes((monitor_id, test_id, scaling.number))
        rows.append(head + b"".join(map(scaling.encode, numbers)))
    return rows
