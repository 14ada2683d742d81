"""Records of on-board diagnostics beside the codes: freeze frames, test results, counts."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FreezeFrame:
    """The signals at the time when a code was set."""

    code: str
    t_ns: int
    values: Mapping[str, float]  # by canonical name, in its unit; only values of good quality


@dataclass(frozen=True, slots=True)
class TestResult:
    """The latest result of a test with its limits, as service $06 reports it."""

    test: str  # a key of codes.TESTS
    quantity: str  # name with its unit, for example lag_rich_to_lean_s
    value: float
    low: float  # lowest value that passes
    high: float  # highest value that passes


@dataclass(frozen=True, slots=True)
class Ratio:
    """In-use monitor performance of one test."""

    test: str  # a key of codes.TESTS
    numerator: int = 0  # driving cycles in which the test could have found a fault
    denominator: int = 0


@dataclass(slots=True)
class Counts:
    """Counts over the vehicle's life and since the codes were cleared."""

    ignition_cycles: int = 0
    general_denominator: int = 0
    warm_ups_since_clear: int = 0
    distance_since_clear_km: float = 0.0
    distance_with_mil_km: float = 0.0
    engine_run_with_mil_s: float = 0.0
    engine_run_since_clear_s: float = 0.0
    sensor_heard: int = 0  # 1 once the sensor's message has come; a clearing keeps it
