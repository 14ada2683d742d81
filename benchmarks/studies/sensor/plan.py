"""Plan of the detection matrix: vehicle, cycle, weather, fault and seed of every trial.

Seeds count up from the seed of the matrix. The vehicle number fixes the piece; the trial's seed
fixes driver, noise and weather. The trials of one fault, severity and placement go through the
vehicles in random order and through all kinds of weather.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeVar

import numpy as np

from benchmarks.studies.options import option
from benchmarks.studies.sensor.conditions import AMBIENTS, ageing, weather
from benchmarks.studies.sensor.severities import (
    LIMIT_SEVERITY,
    NOT_AFTERWARDS,
    SEVERITIES,
    at_limit,
    severities_of,
)
from monitor.base import faults
from monitor.base.errors import UsageError
from monitor.base.faults import Fault
from training.dyno import cycles
from training.dyno.vehicle import Conditions

T = TypeVar("T")
Kind = Literal["calibration", "reference", "healthy", "faulty"]
Placement = Literal["loop", "after", ""]

PLACEMENTS: Final[tuple[Placement, ...]] = ("loop", "after")
REFERENCE_CYCLES: Final = ("wltc_3b", "micro_trips")
HEALTHY_CYCLES: Final = (*("wltc_3b",) * 9, "udds", "us06", "hwfet", "micro_trips")
FAULTY_CYCLES: Final = ("wltc_3b",)
CALIBRATION_VEHICLES: Final = range(3000, 3020)
CALIBRATION_SEED: Final = 3_000_000
REFERENCE_SEEDS: Final = 500_000  # distance of the reference drives' seeds from the first trial's
MOST_ETHANOL: Final = 0.10  # fraction of the fuel
OTHER_SHARE: Final = 4  # severities other than the limit get a quarter of the repetitions

_TRAINED = re.compile(r"_v(\d+)_s(\d+)_")


@dataclass(frozen=True, slots=True)
class Matrix:
    """Size and options of a detection matrix."""

    vehicles: int = option(60, "simulated vehicles")
    first_vehicle: int = option(5000, "number of the first vehicle")
    seed: int = option(5_000_000, "seed of the first drive; every further drive takes the next")
    repetitions: int = option(
        100, "drives per fault and placement at the limit severity, elsewhere a quarter"
    )
    healthy: int = option(600, "healthy drives")
    reference_drives: int = option(40, "healthy drives that teach each vehicle's reference")
    cycles: tuple[str, ...] = option((), "cycles (wltc_3b with a fault, a mixture when healthy)")
    ambients: tuple[str, ...] = option(AMBIENTS, "weather: mild, hot, cold, altitude (all)")
    faults: tuple[tuple[str, tuple[float, ...]], ...] = option(
        tuple(SEVERITIES.items()), "faults NAME[=SEVERITY,…] (all)", severities_of
    )


@dataclass(frozen=True, slots=True)
class Trial:
    """One drive of the matrix."""

    number: int
    kind: Kind
    vehicle: int
    cycle: str
    ambient: str
    seed: int
    aged: Fault | None = None  # ageing of a healthy sensor, within its specification
    fault: str = ""  # "" means healthy
    severity: float | None = None
    placement: Placement = ""  # "after": put on the readings, unseen by the control loop

    @property
    def conditions(self) -> Conditions:
        """Return the weather of the drive."""
        return weather(self.ambient, self.seed)

    @property
    def ethanol(self) -> float:
        """Return the fraction of the fuel."""
        return float(np.random.default_rng([0x0_2, 11, self.seed]).uniform(0.0, MOST_ETHANOL))

    @property
    def name(self) -> str:
        """Return number, cycle, vehicle and fault of the drive in words."""
        what = f"{self.fault} {self.severity:g} {self.placement}" if self.fault else self.kind
        return f"trial {self.number} ({self.cycle}, vehicle {self.vehicle}, {what})"

    def as_row(self) -> dict[str, Any]:
        """Return the trial as JSON values."""
        outside, aged = self.conditions, self.aged
        return {name: getattr(self, name) for name in self.__slots__ if name != "aged"} | {
            "ethanol": self.ethanol,
            "ambient_degc": outside.ambient_degc,
            "ambient_kpa": outside.ambient_kpa,
            "coolant_start_degc": outside.coolant_start_degc,
            "aged": aged
            and {
                "lag_s": aged.tau_rising_s,
                "dead_time_s": aged.delay_s,
                "gain": aged.gain,
                "offset_lambda": aged.offset_lambda,
            },
        }


def reference_drives(matrix: Matrix) -> list[list[Trial]]:
    """Return a list of healthy drives for every vehicle, from which its reference is learned."""
    drives = []
    for i in range(matrix.vehicles):
        numbers = [i * matrix.reference_drives + k for k in range(matrix.reference_drives)]
        own = [
            Trial(
                number,
                "reference",
                matrix.first_vehicle + i,
                _next(matrix.cycles or REFERENCE_CYCLES, i + k),
                _next(matrix.ambients, i + k // 2),
                matrix.seed + REFERENCE_SEEDS + number,
            )
            for k, number in enumerate(numbers)
        ]
        drives.append(own)
    return drives


def trials(matrix: Matrix) -> list[Trial]:
    """Return the healthy drives, then the faulty drives, in the order of their numbers.

    Raises UsageError for a cycle, weather, fault or severity that the simulation does not have.
    """
    _check(matrix)
    found = [_healthy(matrix, i) for i in range(matrix.healthy)]
    cells = [
        (name, severity, placement)
        for name, severities in matrix.faults
        for severity in severities
        for placement in PLACEMENTS[: 1 if name in NOT_AFTERWARDS else 2]
    ]
    for k, cell in enumerate(cells):
        found += _cell(matrix, k, *cell, first=len(found))
    return found


def calibration(matrix: Matrix) -> tuple[list[Trial], list[Trial]]:
    """Return healthy drives and drives with faults at the limit severities.

    The limits of the literature's rules are set on them. In the healthy drives every vehicle drives
    once with a new sensor and once with an aged one.
    """

    def trial(i: int, turn: int, **sensor: Any) -> Trial:
        piece, ambient = _next(CALIBRATION_VEHICLES, i), _next(matrix.ambients, turn)
        return Trial(i, "calibration", piece, "wltc_3b", ambient, CALIBRATION_SEED + i, **sensor)

    n = len(CALIBRATION_VEHICLES)
    aged = [None] * n + [ageing(CALIBRATION_SEED + n + i) for i in range(n)]
    good = [trial(i, i + i // n, aged=each) for i, each in enumerate(aged)]
    bad = [
        trial(i, i // 2, fault=fault, severity=severity, placement=PLACEMENTS[i % 2])
        for i, (fault, severity) in enumerate(2 * list(LIMIT_SEVERITY.items()), len(good))
    ]
    return good, bad


def refuse_used(planned: Iterable[Trial], recordings: Iterable[str]) -> None:
    """Raise UsageError if a vehicle or seed was used to train the model or to set the rules.

    recordings : file names of the model's training recordings
    """
    used = [tuple(map(int, m.groups())) for name in recordings if (m := _TRAINED.search(name))]
    pieces, seeds = {v for v, _ in used}, {s for _, s in used}
    set_on = range(CALIBRATION_SEED, CALIBRATION_SEED + 1000)
    for trial in planned:
        if trial.vehicle in pieces:
            raise UsageError(
                f"vehicle {trial.vehicle} has trained the model: choose others with --first-vehicle"
            )
        if trial.seed in seeds:
            raise UsageError(f"seed {trial.seed} has trained the model: choose others with --seed")
        if trial.vehicle in CALIBRATION_VEHICLES or trial.seed in set_on:
            raise UsageError(
                f"vehicle {trial.vehicle}, seed {trial.seed}: the rules of the literature are set "
                f"on vehicles {CALIBRATION_VEHICLES[0]} to {CALIBRATION_VEHICLES[-1]} and seeds "
                f"from {CALIBRATION_SEED}: choose others"
            )


def _check(matrix: Matrix) -> None:
    if matrix.vehicles < 1 or min(matrix.first_vehicle, matrix.seed) < 0:
        raise UsageError("--vehicles is at least 1, --first-vehicle and --seed at least 0")
    if matrix.repetitions < 1 or min(matrix.healthy, matrix.reference_drives) < 0:
        raise UsageError("--repetitions is at least 1, --healthy and --reference-drives at least 0")
    for cycle in matrix.cycles:
        if cycle not in cycles.NAMES:
            raise UsageError(f"cycle {cycle!r} is unknown; there are {', '.join(cycles.NAMES)}")
    for ambient in matrix.ambients:
        weather(ambient, 0)
    for name, severities in matrix.faults:
        for severity in severities:
            faults.resolve(name, severity)


def _healthy(matrix: Matrix, i: int) -> Trial:
    round_, piece = divmod(i, matrix.vehicles)
    seed = matrix.seed + i
    rng = np.random.default_rng([0x0_2, 9, seed])
    cycle = str(rng.choice(matrix.cycles or HEALTHY_CYCLES))
    aged = ageing(seed) if rng.random() < 0.5 else None
    ambient = _next(matrix.ambients, round_ + piece)
    return Trial(i, "healthy", matrix.first_vehicle + piece, cycle, ambient, seed, aged)


def _cell(
    matrix: Matrix, k: int, fault: str, severity: float, placement: Placement, first: int
) -> Iterator[Trial]:
    """Yield the trials of one fault, severity and placement."""
    rng = np.random.default_rng([0x0_2, 10, matrix.seed, k])
    repetitions = matrix.repetitions
    if not at_limit(fault, severity):
        repetitions = max(1, repetitions // OTHER_SHARE)
    order = np.concatenate(
        [rng.permutation(matrix.vehicles) for _ in range(-(-repetitions // matrix.vehicles))]
    )
    for r in range(repetitions):
        yield Trial(
            number=first + r,
            kind="faulty",
            vehicle=matrix.first_vehicle + int(order[r]),
            cycle=_next(matrix.cycles or FAULTY_CYCLES, r // len(matrix.ambients)),
            ambient=_next(matrix.ambients, r + k),
            seed=matrix.seed + first + r,
            fault=fault,
            severity=severity,
            placement=placement,
        )


def _next(choices: Sequence[T], i: int) -> T:
    return choices[i % len(choices)]
