"""What on-board diagnostics remembers beside the status of each code."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FreezeFrame:
    """The signals at the moment at which a code was set."""

    code: str
    t_ns: int
    values: Mapping[str, float]  # canonical names, in their units; what was not good is left out


@dataclass(frozen=True, slots=True)
class TestResult:
    """The latest result of a test against its limits, as service $06 reports it."""

    test: str  # a key of dtc.TESTS
    quantity: str  # with its unit, as lag_rich_to_lean_s
    value: float
    low: float  # least value that passes
    high: float  # greatest value that passes


@dataclass(frozen=True, slots=True)
class Ratio:
    """In-use monitor performance of one test."""

    test: str  # a key of dtc.TESTS
    numerator: int = 0  # driving cycles in which all conditions to find a fault were met
    denominator: int = 0


@dataclass(frozen=True, slots=True)
class Counts:
    """What is counted over a vehicle's life and since the last clearing."""

    ignition_cycles: int = 0
    general_denominator: int = 0
    warm_ups_since_clear: int = 0
    distance_since_clear_km: float = 0.0
    distance_with_mil_km: float = 0.0
    engine_run_with_mil_s: float = 0.0
    engine_run_since_clear_s: float = 0.0
