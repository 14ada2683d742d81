"""Plan of the catalyst matrix: capacity, evidence, weather, fuel and faults of every trial.

Every trial has a vehicle of its own, whose number is also the seed of driver and noise. Of eight
trials five are main ones, two have a wrong air meter, injector or fuel and no fault, and one is on
the second engine, which shares no equation with dynamometer and monitor.
"""

from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from benchmarks.studies.behind.cases import CYCLES, MODES, Case
from benchmarks.studies.behind.rules import LEARNING
from benchmarks.studies.options import option
from benchmarks.studies.sensor.conditions import AMBIENTS
from monitor.base.errors import UsageError
from training.dyno import vehicle as vehicles

FIRST_VEHICLE: Final = 30_001
KINDS: Final = ("main", "main", "wrong", "main", "main", "second", "main", "wrong")
CAPACITIES_G: Final = (0.03, 0.06, 0.06, 0.15, 0.25, 0.4, None)  # None: the vehicle's own
OFFSETS: Final = (0.0, 0.0, 0.0, 0.02, -0.02)  # of the upstream sensor, in lambda
AGED: Final = "downstream_slow_symmetric"
AGED_S, AGED_SHARE = 1.0, 0.3  # lag of an aged downstream sensor
MOST_ETHANOL_PERCENT: Final = 10.0
WRONG: Final = (
    {"meter": 1.05},
    {"meter": 0.95},
    {"injector": 1.05},
    {"injector": 0.95},
    {"ethanol": 12.8},  # asks for 5 % more fuel
)
SECOND: Final = (  # capacity in g, lag of the rear sensor in s, offset of the front sensor, leak
    (0.03, 0.0, 0.0, 0.0),
    (0.06, 0.0, 0.0, 0.0),
    (0.06, 1.5, 0.0, 0.0),
    (0.25, 0.0, 0.0, 0.0),
    (0.25, 1.5, 0.0, 0.0),
    (0.6, 0.0, 0.0, 0.0),
    (0.4, 0.0, 0.02, 0.0),
    (0.4, 0.0, -0.02, 0.0),
    (0.4, 0.0, 0.0, 0.02),
)


@dataclass(frozen=True, slots=True)
class CatalystMatrix:
    """Size of a catalyst matrix."""

    drives: int = option(840, "drives, a vehicle each")
    first_vehicle: int = option(FIRST_VEHICLE, "number of the first vehicle")
    seconds: float = option(600.0, "length of each drive, at least 60")


@dataclass(frozen=True, slots=True)
class CatalystTrial:
    """One drive of the matrix."""

    number: int
    kind: str  # "main", "wrong" or "second"
    vehicle: int
    cycle: str  # "" is the second engine's own way of driving
    ambient: str  # weather; "" on the second engine
    case: Case

    @property
    def offset_lambda(self) -> float:
        """Return by how much the upstream sensor reads too lean."""
        own = 0.0 if self.kind == "second" else vehicles.piece(self.vehicle).sensor_offset
        return self.case.offset_lambda - own

    def as_row(self) -> dict[str, Any]:
        """Return the trial as JSON values."""
        row = asdict(self)
        case = row.pop("case")
        return row | case | {"offset_lambda": self.offset_lambda}


def trials(matrix: CatalystMatrix) -> list[CatalystTrial]:
    """Return every trial.

    Raises UsageError for a vehicle that set the rules' limits, or a drive without time to judge.
    """
    if matrix.drives < 1 or matrix.seconds < 60.0:
        raise UsageError("at least one drive of 60 s is wanted behind the catalyst")
    if matrix.first_vehicle <= max(LEARNING):
        raise UsageError(f"vehicles up to {max(LEARNING)} set limits of the catalyst's rules")
    return [_trial(i, matrix.first_vehicle + i) for i in range(matrix.drives)]


def _trial(i: int, vehicle: int) -> CatalystTrial:
    rng = np.random.default_rng([31, vehicle])
    kind, turn = KINDS[i % len(KINDS)], i // len(KINDS)
    if kind == "second":
        return CatalystTrial(i, kind, vehicle, "", "", _second(*SECOND[turn % len(SECOND)]))
    mode, cycle = (str(rng.choice(of)) for of in (MODES, CYCLES))
    ambient = str(rng.choice(AMBIENTS))
    if kind == "wrong":
        parts: dict[str, float] = dict(WRONG[int(rng.integers(len(WRONG)))])
        return CatalystTrial(
            i,
            kind,
            vehicle,
            cycle,
            ambient,
            Case("wrong", mode=mode, **parts),  # type: ignore[arg-type]
        )
    aged = bool(rng.random() < AGED_SHARE)
    offset = OFFSETS[int(rng.integers(len(OFFSETS)))]
    case = Case(
        "main",
        CAPACITIES_G[int(rng.integers(len(CAPACITIES_G)))],
        sensor=AGED if aged else "",
        sensor_severity=AGED_S if aged else None,
        upstream=_upstream(offset),
        ethanol=float(rng.uniform(0.0, MOST_ETHANOL_PERCENT)),
        mode=mode,
    )
    return CatalystTrial(i, kind, vehicle, cycle, ambient, case)


def _second(grams: float, lag_s: float, offset: float, leak: float) -> Case:
    """Return the case of a drive of the second engine."""
    return Case(
        "second",
        grams,
        sensor=AGED if lag_s else "",
        sensor_severity=lag_s or None,
        upstream=_upstream(offset),
        leak=leak,
    )


def _upstream(offset: float) -> str:
    return {1: "biased_lean", -1: "biased_rich"}.get(int(np.sign(offset)), "")
