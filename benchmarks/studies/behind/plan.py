"""Plan of the catalyst matrix: capacity, evidence, weather, fuel and faults of every trial.

Every trial has a vehicle of its own, whose number is also the seed of driver and noise. Of eight
trials five are main ones, two have a wrong air meter, injector or fuel and no fault, and one is on
the second engine, which shares no equation with dynamometer and monitor.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np

from benchmarks.studies.options import option
from benchmarks.studies.sensor.conditions import AMBIENTS
from monitor.base.errors import UsageError
from training.dyno import vehicle as vehicles

FIRST_VEHICLE: Final = 30_001
LEARNING: Final = (3, 4, 5, 11, 12, 13, 14, 15, 16)  # vehicles that set limits of the rules
KINDS: Final = ("main", "main", "wrong", "main", "main", "second", "main", "wrong")
CYCLES: Final = ("wltc_3b", "udds", "micro_trips")
MODES: Final = ("passive", "cut", "active")
CAPACITIES_G: Final = (0.03, 0.06, 0.06, 0.15, 0.25, 0.4, None)  # None: the vehicle's own
OFFSETS: Final = (0.0, 0.0, 0.0, 0.02, -0.02)  # of the upstream sensor, in lambda
AGED: Final = "downstream_slow_symmetric"
AGED_S, AGED_SHARE = 1.0, 0.3  # lag of an aged downstream sensor
MOST_ETHANOL_PERCENT: Final = 10.0
WRONG: Final[tuple[dict[str, Any], ...]] = (
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
    """One drive of the matrix; what it does not say are the vehicle's own parts."""

    number: int
    kind: str  # "main", "wrong", "second" or "rules"
    vehicle: int
    cycle: str = ""  # "" is the second engine's own way of driving
    ambient: str = ""  # weather; "" is what the vehicle's number draws
    mode: str = "cut"  # "passive": no fuel cut, "active": fuel cut and the ECU's own steps
    grams: float | None = None
    lag_s: float = 0.0  # of an aged downstream sensor
    bias_lambda: float = 0.0  # offset of a faulty upstream sensor
    leak: float = 0.0
    ethanol: float = 0.0  # percent
    meter: float = 1.0  # factor on the air meter
    injector: float = 1.0  # factor on the injectors

    @property
    def sensor(self) -> str:
        """Return the fault of the downstream sensor, "" without one."""
        return AGED if self.lag_s else ""

    @property
    def upstream(self) -> str:
        """Return the fault of the upstream sensor, "" without one."""
        return {1: "biased_lean", -1: "biased_rich"}.get(int(np.sign(self.bias_lambda)), "")

    def as_row(self) -> dict[str, Any]:
        """Return the trial as JSON values; ``offset_lambda`` is how much too lean is read."""
        own = 0.0 if self.kind == "second" else vehicles.piece(self.vehicle).sensor_offset
        offset = {"offset_lambda": self.bias_lambda - own}
        return asdict(self) | {"sensor": self.sensor, "upstream": self.upstream} | offset


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
        grams, lag_s, offset, leak = SECOND[turn % len(SECOND)]
        return CatalystTrial(
            i, kind, vehicle, grams=grams, lag_s=lag_s, bias_lambda=offset, leak=leak
        )
    mode, cycle = (str(rng.choice(of)) for of in (MODES, CYCLES))
    trial = CatalystTrial(i, kind, vehicle, cycle, str(rng.choice(AMBIENTS)), mode)
    if kind == "wrong":
        return replace(trial, **WRONG[int(rng.integers(len(WRONG)))])
    lag_s = AGED_S if rng.random() < AGED_SHARE else 0.0
    return replace(
        trial,
        lag_s=lag_s,
        bias_lambda=OFFSETS[int(rng.integers(len(OFFSETS)))],
        grams=CAPACITIES_G[int(rng.integers(len(CAPACITIES_G)))],
        ethanol=float(rng.uniform(0.0, MOST_ETHANOL_PERCENT)),
    )
