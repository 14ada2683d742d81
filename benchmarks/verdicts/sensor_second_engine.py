"""The sensor monitor on vehicles of the second engine, whose equations are not the dynamometer's.

Every vehicle has its own form of the equations (``Form.of``) and a canister that purges. Five
healthy drives with E5 train a model, which then judges drives that nothing was fitted to, each with
a fuel of its own from E0 to E10: healthy ones, every second with a sensor aged within its
specification; faults at their limit severities in the control loop and put on the readings
afterwards; offsets in a first drive, and after three healthy drives that taught the vehicle's
reference. The fault memory is empty in every drive.

``--models`` keeps the models in DIR and uses those it finds there. All drives are simulated.

python -m benchmarks sensor_second_engine [FIRST_VEHICLE VEHICLES] [--kinds narx greybox]
    [--models DIR] [--budget MINUTES] [--faults NAME ...]
"""

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

import training
from benchmarks.outcome import BenchmarkOptions, Row, finish, say
from benchmarks.studies.second.engine import (
    LEANEST,
    LENGTH_S,
    PERIOD_S,
    SOUND,
    Form,
    Sensor,
    broadcast,
)
from benchmarks.studies.sensor import severities
from benchmarks.studies.sensor.conditions import ageing
from benchmarks.studies.sensor.plan import MOST_ETHANOL
from benchmarks.studies.sensor.run import judge_drives, learn
from benchmarks.studies.sensor.severities import LIMIT_SEVERITY
from monitor.base import config, faults
from monitor.base.signals import OUTPUT
from monitor.base.types import FloatArray, SampleBlock
from monitor.grid.arrays import table_of
from monitor.grid.table_samples import READY, table_block
from monitor.judge.limits import Limits
from monitor.memory.reference import Reference
from monitor.model.step import Model
from training.limits.judging import Judged
from training.recordings.sensor_fault import faulty_readings

CONFIG: Final = config.load()
TRAINING_DRIVES: Final = 5
TRAINING_ETHANOL: Final = 0.05  # of the fuel
JUDGED_S: Final = 900.0  # after a cold start an engine is warm in some 600 s; drifts: half an hour
TAUGHT, OFFSET_DRIVES = 3, 3  # healthy drives, then drives with the offset
PURGE: Final = 1.0  # of the size of the noise
KINDS: Final = ("narx", "greybox")
OFFSETS: Final = ("biased_lean", "biased_rich")
ELECTRICAL: Final = tuple(name for name in severities.ELECTRICAL if name != "heater")
BROKEN_FROM_S: Final = 60.0  # a message that never came is no fault that a first drive can show
NAMES: Final = (*LIMIT_SEVERITY, *ELECTRICAL)


class SensorCase(NamedTuple):
    """A drive and what its sensor has."""

    number: int  # draws driver, noise, weather and fuel
    fault: str = ""
    in_loop: bool = True


def columns(vehicle: int, case: SensorCase) -> dict[str, FloatArray]:
    """Return what the ECU sends in a drive, with ``time_s``, name → (n,)."""
    seed = 1000 * vehicle + case.number
    rng = np.random.default_rng([0x5E, seed])
    ethanol = rng.uniform(0.0, MOST_ETHANOL) if case.number >= TRAINING_DRIVES else TRAINING_ETHANOL
    fault = faults.resolve(case.fault, LIMIT_SEVERITY.get(case.fault)) if case.fault else None
    sensor = SOUND
    if fault and case.in_loop:
        sensor = Sensor.of(fault, BROKEN_FROM_S if fault.missing else 0.0)
    elif not fault and case.number >= TRAINING_DRIVES and case.number % 2:
        sensor = Sensor.of(ageing(seed))
    length_s = LENGTH_S if case.number < TRAINING_DRIVES else JUDGED_S
    length_s = faults.DRIFT_S if case.fault.startswith("drift") else length_s
    own = {"ethanol": 100.0 * float(ethanol), "purge": PURGE}
    sent = broadcast(vehicle, seed, own, sensor, length_s, Form.of(vehicle))
    if fault and not case.in_loop:
        read = faulty_readings(fault, sent[OUTPUT], PERIOD_S)
        sent[OUTPUT] = np.minimum(read, LEANEST)
    if fault and fault.missing:  # its readiness stands in the same message
        sent[READY] = np.where(np.isnan(sent[OUTPUT]), np.nan, sent[READY])
    times = np.arange(len(sent[OUTPUT]), dtype=np.float64)
    return {"time_s": PERIOD_S * times} | sent


class MonitoredVehicle:
    """A vehicle and its monitor."""

    def __init__(self, vehicle: int, kind: str, folder: Path, drives: int, budget: float) -> None:
        self.vehicle, path = vehicle, folder / f"{kind}_{vehicle}.onnx"
        if not path.exists():
            healthy = [columns(vehicle, SensorCase(i)) for i in range(drives)]
            if kind == "greybox":
                training.fit(healthy, path, kind="greybox")
            else:
                training.fit(healthy, path, budget_minutes=budget, threads=1)
        self._model = Model.load(path)
        self._limits = Limits.from_card(self._model.card, CONFIG, str(path))

    def judged(
        self, cases: Sequence[SensorCase], reference: Reference | None = None
    ) -> list[Judged]:
        """Return the verdicts on drives."""
        tables = [table_of(columns(self.vehicle, case), str(case.number)) for case in cases]
        names = tables[0].names
        blocks: list[SampleBlock] = [table_block(table, names, None) for table in tables]
        known = [reference] * len(blocks)
        return judge_drives(blocks, names, self._model, self._limits, CONFIG, known)

    def after_healthy(self, first: int, fault: str, *, in_loop: bool) -> tuple[Judged, ...]:
        """Return the verdicts on three healthy drives, then on drives with a fault until a code."""
        known, seen = None, []
        for k in range(TAUGHT + OFFSET_DRIVES):
            case = SensorCase(first + k, fault, in_loop) if k >= TAUGHT else SensorCase(first + k)
            [judged] = self.judged([case], known)
            seen.append(judged)
            if k >= TAUGHT and judged.dtcs:
                break
            known = learn(known, judged, CONFIG)
        return tuple(seen)


def cases(names: Sequence[str], healthy: int, repetitions: int) -> Iterator[SensorCase]:
    """Yield the drives of a vehicle that are judged without a reference."""
    for k in range(healthy):
        yield SensorCase(100 + k)
    for fault in names:
        i = NAMES.index(fault)  # the same drives for any choice of faults
        for k in range(1 if fault in ELECTRICAL else repetitions):
            for in_loop in (True, False)[: 1 if fault in severities.NOT_AFTERWARDS else 2]:
                yield SensorCase(200 + 10 * i + 2 * k + in_loop, fault, in_loop)


class Said(NamedTuple):
    """Names of the codes of a drive."""

    vehicle: int
    case: SensorCase
    names: tuple[str, ...]
    also: tuple[str, ...]
    completed: bool

    @property
    def wanted(self) -> tuple[str, ...]:
        """Return the right names."""
        return (self.case.fault,) if self.case.fault else ()


def said(vehicle: int, case: SensorCase, judged: Judged) -> Said:
    """Return the names that a drive was given."""
    names = tuple(dict.fromkeys(dtc.fault for dtc in judged.dtcs))
    also = tuple(dict.fromkeys(name for dtc in judged.dtcs for name in dtc.also))
    return Said(vehicle, case, names, also, judged.completed)


def rows_of(kind: str, drives: Sequence[Said]) -> Iterator[Row]:
    """Yield a row for each group and each fault, and say each drive that was named wrongly."""
    groups: dict[str, Sequence[str]] = {
        "healthy": ("",),
        "response and gain": [name for name in LIMIT_SEVERITY if name not in OFFSETS],
        "offsets, first drive": OFFSETS,
        "electrical": ELECTRICAL,
    }
    for title, names in (groups | {name: (name,) for name in NAMES}).items():
        for in_loop in (True, False):
            own = [d for d in drives if d.case.fault in names and d.case.in_loop == in_loop]
            if own:
                yield {
                    "kind": kind,
                    "of": title,
                    "fault is": "in the loop" if in_loop else "put on",
                    "drives": len(own),
                    "found": sum(bool(each.names) for each in own),
                    "named exactly": sum(each.names == each.wanted for each in own),
                    "or listed": sum(set(each.wanted) <= {*each.names, *each.also} for each in own),
                    "judged": sum(each.completed or bool(each.names) for each in own),
                }
    for each in drives:
        if each.names != each.wanted and each.case.fault not in OFFSETS:
            say(str(each))


def offsets(bench: MonitoredVehicle, repetitions: int) -> tuple[list[int], int]:
    """Return in which drive with the offset each had its name, and codes in the drives before."""
    drive, false = [], 0
    for i, fault in enumerate(OFFSETS):
        for in_loop in (True, False):
            for k in range(repetitions):
                first = 500 + 100 * i + 50 * in_loop + 10 * k
                seen = bench.after_healthy(first, fault, in_loop=in_loop)
                false += sum(bool(each.dtcs) for each in seen[:TAUGHT])
                named = [dtc.fault == fault for dtc in seen[-1].dtcs]
                drive.append(len(seen) - TAUGHT if named and all(named) else 0)
                if drive[-1] != 1:
                    codes = [dtc.fault for dtc in seen[-1].dtcs]
                    say(f"vehicle {bench.vehicle} {fault} from {first}: drive {drive[-1]} {codes}")
    return drive, false


def main(argv: Sequence[str]) -> int:
    """Fit and judge."""
    few = {"vehicles": 1, "drives": 2, "healthy": 1, "repetitions": 1, "budget": 0.02}
    options = BenchmarkOptions(__name__, __doc__, kinds=["narx"], faults=["gain_low"], **few)
    options.add_argument("first_vehicle", type=int, nargs="?", default=301)
    options.add_argument("vehicles", type=int, nargs="?", default=2)
    options.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    options.add_argument("--models", type=Path)
    options.add_argument("--drives", type=int, default=TRAINING_DRIVES, help="that train")
    options.add_argument("--budget", type=float, default=10.0)
    options.add_argument("--faults", nargs="+", choices=NAMES, default=NAMES)
    options.add_argument("--healthy", type=int, default=8, help="drives of each vehicle")
    options.add_argument("--repetitions", type=int, default=3, help="of each fault")
    args = options.parse_args(argv)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as spare:
        folder = args.models or Path(spare)
        folder.mkdir(parents=True, exist_ok=True)
        for kind in args.kinds:
            drives, when, false = list[Said](), list[int](), 0
            for vehicle in range(args.first_vehicle, args.first_vehicle + args.vehicles):
                bench = MonitoredVehicle(vehicle, kind, folder, args.drives, args.budget)
                each = list(cases(args.faults, args.healthy, args.repetitions))
                verdicts = bench.judged(each)
                drives += [said(vehicle, *pair) for pair in zip(each, verdicts, strict=True)]
                if set(OFFSETS) <= set(args.faults):
                    drive, codes = offsets(bench, args.repetitions)
                    when, false = when + drive, false + codes
            rows += rows_of(kind, drives)
            if when:
                by = {f"by drive {k}": sum(0 < n <= k for n in when) for k in range(1, 4)}
                taught = {"healthy before": TAUGHT * len(when), "with a code": false}
                rows.append({"kind": kind, "taught offsets": len(when)} | by | taught)
    return finish(args, rows)
