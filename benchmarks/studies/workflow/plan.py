"""Plan of the gap study: hidden effects and faults, vehicles, drives and seeds of every case.

Every drive has its seed, counted up from the seed of the study. The cases of a kind go through all
vehicles. The order of the cases is random, so that an interrupted study holds a fair share of every
kind.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import combinations, product
from typing import Any, Final

import numpy as np

from benchmarks.studies.options import option
from benchmarks.studies.sensor.severities import ELECTRICAL
from benchmarks.studies.sensor.severities import SEVERITIES as FAULT_SEVERITIES
from monitor.base.errors import UsageError

KINDS: Final = ("effect", "null", "unknown", "two", "onset", "fault")
FAULTY: Final = ("onset", "fault")  # kinds of cases with a sensor fault
CASES: Final = {"effect": 240, "null": 400, "unknown": 60, "two": 60, "onset": 110, "fault": 110}
OF_BASE: Final = {"greybox": CASES, "narx": CASES | {"null": 200}}
USUAL: Final = (0.5, 1.0, 2.0, 4.0, 8.0)  # severities; 1 moves lambda by about the plant's noise
TWICE: Final = tuple(2.0 * severity for severity in USUAL)
# The largest severity moves the base model's error by about eight times the noise that the workflow
# sees (this noise is larger than the plant's). Two effects cannot go so far: sensor_asymmetry
# becomes unstable, maf_pulsation saturates.
SEVERITIES: Final[dict[str, tuple[float, ...]]] = {
    "wall_film": USUAL,
    "delay_flow": TWICE,
    "mix_flow": TWICE,
    "sensor_asymmetry": (0.4, 0.8, 1.2, 1.4, 1.6),
    "injector_offset": TWICE,
    "rail_exponent": TWICE,
    "maf_offset": TWICE,
    "maf_pulsation": USUAL,
    "purge": TWICE,
    "exhaust_leak": TWICE,
    "back_pressure": USUAL,
    "scavenging": USUAL,
    "fuel_cut_tail": TWICE,
    "charge_temperature": (4.0, 8.0, 16.0, 24.0, 32.0),
    "manifold_filling": TWICE,
    "ethanol": TWICE,
}
UNKNOWN_SEVERITIES: Final = (4.0, 8.0, 16.0)
OF_TWO: Final = (2, 3)  # indices into an effect's severities, for cases with two effects
UNKNOWN: Final = ("oil_dilution", "battery_voltage", "intake_resonance")  # not in the library
CYCLES: Final = ("micro_trips", "wltc_3b", "udds", "us06", "micro_trips", "hwfet")
LENGTH_S: Final = {"wltc_3b": 1800.0, "udds": 1369.0, "us06": 596.0, "hwfet": 765.0}
MICRO_TRIPS_S: Final = 1200.0
COLD_SHARE: Final = 0.5  # share of the recordings that begin with the start of the engine
ONSET: Final = (0.2, 0.8)  # a fault begins within this part of its recording
HEALTHY_DRIVES: Final = 8
MOST_DRIVES: Final = 10
HEALTHY_SEEDS: Final = 500_000  # distance of the healthy drives' seeds from the cases' first seed
MOST_VEHICLES: Final = 10_000


def number_of(text: str) -> tuple[str, int]:
    """Return kind and number of ``KIND=N``."""
    kind, _, number = text.partition("=")
    if not number.isdecimal():
        raise UsageError(f"--cases {text!r}: wanted KIND=N")
    return kind, int(number)


@dataclass(frozen=True, slots=True)
class Study:
    """Size and options of a gap study."""

    base: str = option("greybox", "kind of the model under study, greybox or narx")
    cases: tuple[tuple[str, int], ...] = option(
        (), f"cases KIND=N of {', '.join(KINDS)} (60 to 400 of each)", number_of
    )
    vehicles: int = option(20, "simulated vehicles")
    first_vehicle: int = option(2100, "number of the first vehicle")
    seed: int = option(2_000_000, "seed of the first drive; every further drive takes the next")
    drives: int = option(6, "recordings per case")
    minutes: float = option(10.0, "length of a recording")
    fitted_with_effect: bool = option(
        False, "fit the model to the recordings of its case that are not held out"
    )
    sensor_known_good: bool = option(
        False, "declare the sensor good; leaves out the kinds onset and fault"
    )

    def __post_init__(self) -> None:
        if self.base not in OF_BASE:
            raise UsageError(f"base {self.base!r} is unknown; there are {', '.join(OF_BASE)}")
        if not self.cases:
            left_out = FAULTY if self.sensor_known_good else ()
            own = {k: n for k, n in OF_BASE[self.base].items() if k not in left_out}
            object.__setattr__(self, "cases", tuple(own.items()))
        for kind, _ in self.cases:
            if kind not in KINDS:
                raise UsageError(f"kind {kind!r} is unknown; there are {', '.join(KINDS)}")
            if self.sensor_known_good and kind in FAULTY:
                raise UsageError(f"kind {kind!r}: its sensors are not known to be good")
        if not 1 <= self.vehicles <= MOST_VEHICLES:
            raise UsageError(f"--vehicles is 1 to {MOST_VEHICLES}")
        if min(self.first_vehicle, self.seed) < 0:
            raise UsageError("--first-vehicle and --seed are at least 0")
        if not 2 <= self.drives <= MOST_DRIVES:
            raise UsageError(f"--drives is 2 to {MOST_DRIVES}: one is held out")
        if not 2.0 <= self.minutes <= 60.0:
            raise UsageError("--minutes is 2 to 60")

    @property
    def duration_s(self) -> float:
        """Return the length of a recording."""
        return 60.0 * self.minutes

    @property
    def count(self) -> int:
        """Return the number of cases."""
        return sum(number for _, number in self.cases)


@dataclass(frozen=True, slots=True)
class Part:
    """One recording: a part of a simulated drive."""

    cycle: str
    seed: int
    start_s: float  # start of the recording within the drive; 0 is the start of the engine
    fault_start_s: float | None  # start of the fault within the drive; None: a healthy sensor


@dataclass(frozen=True, slots=True)
class Case:
    """One case: the hidden effects or fault, the vehicle and its recordings."""

    number: int
    kind: str
    vehicle: int
    hidden: tuple[tuple[str, float], ...]  # effects with severities in units of the plant's noise
    fault: tuple[str, float] | None
    parts: tuple[Part, ...]

    @property
    def what(self) -> str:
        """Return the names of the hidden effects and fault, or ``nothing``."""
        names = [name for name, _ in self.hidden] + ([self.fault[0]] if self.fault else [])
        return " + ".join(names) or "nothing"

    def as_row(self) -> dict[str, Any]:
        """Return the case as JSON values."""
        fault, severity = self.fault or (None, None)
        return {
            "number": self.number,
            "kind": self.kind,
            "vehicle": self.vehicle,
            "hidden": [name for name, _ in self.hidden],
            "severities": [severity for _, severity in self.hidden],
            "fault": fault,
            "fault_severity": severity,
            "parts": [asdict(part) for part in self.parts],
        }


def cases(study: Study) -> list[Case]:
    """Return every case in the order of execution."""
    planned: list[Case] = []
    for kind, number in study.cases:
        planned += _of_kind(study, kind, number, first=len(planned))
    order = np.random.default_rng([0x0_2, 21, study.seed]).permutation(len(planned))
    return [planned[i] for i in order]


def healthy_parts(study: Study, vehicle: int) -> tuple[Part, ...]:
    """Return the vehicle's healthy recordings; no case shares their seeds."""
    first = study.seed + HEALTHY_SEEDS + MOST_DRIVES * (vehicle - study.first_vehicle)
    return tuple(_part(study, first + i, i, None) for i in range(HEALTHY_DRIVES))


def _of_kind(study: Study, kind: str, number: int, first: int) -> Iterator[Case]:
    """Yield the cases of one kind; every round uses each vehicle once, in random order."""
    rng = np.random.default_rng([0x0_2, 22, KINDS.index(kind), study.seed])
    hidden = _hidden(kind, rng)
    rounds = -(-number // study.vehicles)
    order = np.array([rng.permutation(study.vehicles) for _ in range(rounds)]).ravel()
    for i in range(number):
        effects, fault = hidden[i % len(hidden)]
        vehicle = study.first_vehicle + int(order[i])
        seed = study.seed + MOST_DRIVES * (first + i)
        begins = _begins(study, kind, rng)
        parts = tuple(
            _part(study, seed + k, k + first + i, begins[k] if fault else None)
            for k in range(study.drives)
        )
        yield Case(first + i, kind, vehicle, effects, fault, parts)


Hidden = tuple[tuple[tuple[str, float], ...], tuple[str, float] | None]


def _hidden(kind: str, rng: np.random.Generator) -> list[Hidden]:
    """Return all hidden effects and faults of a kind of cases, in random order."""
    found: list[Hidden]
    if kind == "null":
        return [((), None)]
    if kind == "effect":
        found = [(((n, s),), None) for n, sizes in SEVERITIES.items() for s in sizes]
    elif kind == "unknown":
        found = [(((n, s),), None) for n, s in product(UNKNOWN, UNKNOWN_SEVERITIES)]
    elif kind == "two":
        found = [
            (((a, SEVERITIES[a][i]), (b, SEVERITIES[b][j])), None)
            for a, b in combinations(SEVERITIES, 2)
            for i, j in [rng.choice(OF_TWO, 2).tolist()]
        ]
    else:
        found = [
            ((), (name, severity))
            for name, sizes in FAULT_SEVERITIES.items()
            if name not in ELECTRICAL
            for severity in sizes
        ]
    return [found[i] for i in rng.permutation(len(found))]


def _begins(study: Study, kind: str, rng: np.random.Generator) -> list[float | None]:
    """Return the start of the fault in every recording, in seconds; None before the fault.

    A fault with an onset begins within one recording and lasts through all later ones.
    """
    if kind != "onset":
        return [0.0] * study.drives
    at = int(rng.integers(study.drives))
    begins: list[float | None] = [None] * at + [0.0] * (study.drives - at)
    begins[at] = float(rng.uniform(*ONSET)) * study.duration_s
    return begins


def _part(study: Study, seed: int, turn: int, begins_s: float | None) -> Part:
    """Return the plan of one recording.

    turn : index that selects the driving cycle
    begins_s : start of the fault within the recording; None means no fault
    """
    rng = np.random.default_rng([0x0_2, 23, seed])
    cycle = CYCLES[turn % len(CYCLES)]
    room_s = LENGTH_S.get(cycle, MICRO_TRIPS_S) - study.duration_s
    cold = rng.random() < COLD_SHARE
    start_s = 0.0 if cold or room_s <= 0.0 else float(round(rng.uniform(0.0, room_s)))
    # A fault that covers the whole recording is present from the start of the drive.
    fault_start_s = None if begins_s is None else begins_s + start_s if begins_s else 0.0
    return Part(cycle, seed, start_s, fault_start_s)
