"""The sensor monitor on vehicles of the second engine, whose equations are not the dynamometer's.

Every vehicle has its own form of the equations (``Form.of``) and a canister that purges. Five
healthy drives with E5 train a model, which then judges drives that nothing was fitted to, each with
a fuel of its own from E0 to E10: healthy ones, every second with a sensor aged within its
specification; faults at their limit severities in the control loop and put on the readings
afterwards; offsets in a first drive, and after three healthy drives that taught the vehicle's
reference. The fault memory is empty in every drive.

    python -m benchmarks sensor_second_engine FIRST_VEHICLE VEHICLES [--kinds narx greybox]
        [--models DIR] [--budget MINUTES] [--faults NAME…]

``--models`` keeps the models in DIR and uses those it finds there. All drives are simulated.
"""

import argparse
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

import training
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
from benchmarks.studies.sensor.goals import LIMIT_SEVERITY
from benchmarks.studies.sensor.plan import MOST_ETHANOL
from benchmarks.studies.sensor.verdicts import judge_drives, learn
from monitor.base import config, faults
from monitor.base.fault_streams import SensorFault
from monitor.base.signals import OUTPUT
from monitor.base.types import FloatArray, SampleBlock
from monitor.grid.arrays import table_of
from monitor.grid.table_samples import table_block
from monitor.judge.limits import Limits
from monitor.memory.reference import Reference
from monitor.model.step import Model
from monitor.pipeline.side_by_side import Judged

CONFIG: Final = config.load()
TRAINING_DRIVES, HEALTHY_DRIVES, REPETITIONS = 5, 8, 3
TRAINING_ETHANOL: Final = 0.05  # of the fuel
JUDGED_S: Final = 900.0  # after a cold start an engine is warm in some 600 s; drifts: half an hour
TAUGHT, OFFSET_DRIVES = 3, 3  # healthy drives, then drives with the offset
PURGE: Final = 1.0  # of the size of the noise
OFFSETS: Final = ("biased_lean", "biased_rich")
ELECTRICAL: Final = tuple(name for name in severities.ELECTRICAL if name != "heater")
BROKEN_FROM_S: Final = 60.0  # a message that never came is no fault that a first drive can show
NAMES: Final = (*LIMIT_SEVERITY, *ELECTRICAL)
IN_A_TABLE: Final = {"signal_missing": "signal_invalid"}  # an empty cell is sent as invalid


class Case(NamedTuple):
    """A drive and what its sensor has."""

    number: int  # draws driver, noise, weather and fuel
    fault: str = ""
    in_loop: bool = True


def columns(vehicle: int, case: Case) -> dict[str, FloatArray]:
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
        read = SensorFault(fault, PERIOD_S).apply(sent[OUTPUT].tolist())
        sent[OUTPUT] = np.minimum(read, LEANEST)
    times = np.arange(len(sent[OUTPUT]), dtype=np.float64)
    return {"time_s": PERIOD_S * times} | sent


class Bench:
    """A vehicle and its monitor."""

    def __init__(self, vehicle: int, kind: str, folder: Path, budget: float) -> None:
        self.vehicle, path = vehicle, folder / f"{kind}_{vehicle}.onnx"
        if not path.exists():
            healthy = [columns(vehicle, Case(i)) for i in range(TRAINING_DRIVES)]
            if kind == "greybox":
                training.fit(healthy, path, kind="greybox")
            else:
                training.fit(healthy, path, budget_minutes=budget, threads=1)
        self._model = Model.load(path)
        self._limits = Limits.from_card(self._model.card, CONFIG, str(path))

    def judged(self, cases: Sequence[Case], reference: Reference | None = None) -> list[Judged]:
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
            case = Case(first + k, fault, in_loop) if k >= TAUGHT else Case(first + k)
            [judged] = self.judged([case], known)
            seen.append(judged)
            if k >= TAUGHT and judged.dtcs:
                break
            known = learn(known, judged, CONFIG)
        return tuple(seen)


def cases(names: Sequence[str]) -> Iterator[Case]:
    """Yield the drives of a vehicle that are judged without a reference."""
    for k in range(HEALTHY_DRIVES):
        yield Case(100 + k)
    for fault in names:
        i = NAMES.index(fault)  # the same drives for any choice of faults
        for k in range(1 if fault in ELECTRICAL else REPETITIONS):
            for in_loop in (True, False)[: 1 if fault in severities.NOT_AFTERWARDS else 2]:
                yield Case(200 + 10 * i + 2 * k + in_loop, fault, in_loop)


class Said(NamedTuple):
    """Names of the codes of a drive."""

    vehicle: int
    case: Case
    names: tuple[str, ...]
    also: tuple[str, ...]
    completed: bool

    @property
    def wanted(self) -> tuple[str, ...]:
        """Return the right names."""
        fault = self.case.fault
        return (IN_A_TABLE.get(fault, fault),) if fault else ()


def said(vehicle: int, case: Case, judged: Judged) -> Said:
    """Return the names that a drive was given."""
    names = tuple(dict.fromkeys(dtc.fault for dtc in judged.dtcs))
    also = tuple(dict.fromkeys(name for dtc in judged.dtcs for name in dtc.also))
    return Said(vehicle, case, names, also, judged.completed)


def table(drives: Sequence[Said]) -> None:
    """Print counts, the names of each fault, and every drive that was missed or named wrongly."""
    healthy = [each for each in drives if not each.case.fault]
    codes = sum(bool(each.names) for each in healthy)
    print(f"healthy: {codes} of {len(healthy)} have a code, ", end="")
    print(f"{sum(each.completed for each in healthy)} judged")
    response = [name for name in LIMIT_SEVERITY if name not in OFFSETS]
    groups = {
        "response and gain": response,
        "offsets, first drive": OFFSETS,
        "electrical": ELECTRICAL,
    }
    for title, names in groups.items():
        for in_loop in (True, False):
            own = [d for d in drives if d.case.fault in names and d.case.in_loop == in_loop]
            print(f"{title}, {'in the loop' if in_loop else 'put on'}: {counts(own)}")
    for fault in dict.fromkeys(each.case.fault for each in drives if each.case.fault):
        own = [each for each in drives if each.case.fault == fault]
        codes_of = Counter(" ".join(each.names) or "-" for each in own)
        names_of = ", ".join(f"{n} {names}" for names, n in codes_of.items())
        print(f"  {fault}: {counts(own)}; {names_of}")
    for each in drives:
        if each.names != each.wanted and each.case.fault not in OFFSETS:
            print(f"  {each}")


def counts(drives: Sequence[Said]) -> str:
    """Return how many drives have a code, and how many the right one alone."""
    found = sum(bool(each.names) for each in drives)
    named = sum(each.names == each.wanted for each in drives)
    listed = sum(set(each.wanted) <= {*each.names, *each.also} for each in drives)
    judged = sum(each.completed or bool(each.names) for each in drives)
    n = len(drives)
    return f"{found} of {n} found, {named} named exactly, {listed} or listed, {judged} judged"


def offsets(bench: Bench) -> tuple[list[int], int, int]:
    """Return in which drive with the offset each had its name, and codes before, of how many."""
    drive, false, n = [], 0, 0
    for i, fault in enumerate(OFFSETS):
        for in_loop in (True, False):
            for k in range(REPETITIONS):
                first = 500 + 100 * i + 50 * in_loop + 10 * k
                seen = bench.after_healthy(first, fault, in_loop=in_loop)
                false += sum(bool(each.dtcs) for each in seen[:TAUGHT])
                n += TAUGHT
                named = [dtc.fault == fault for dtc in seen[-1].dtcs]
                drive.append(len(seen) - TAUGHT if named and all(named) else 0)
                if drive[-1] != 1:
                    where = "in the loop" if in_loop else "put on"
                    codes = [dtc.fault for dtc in seen[-1].dtcs]
                    print(
                        f"  vehicle {bench.vehicle} {fault} {where} from {first}: "
                        f"drive {drive[-1]} {codes}"
                    )
    return drive, false, n


def main(argv: Sequence[str]) -> int:
    """Fit, judge and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("first_vehicle", type=int)
    parser.add_argument("vehicles", type=int)
    parser.add_argument("--kinds", nargs="+", choices=("narx", "greybox"))
    parser.add_argument("--models", type=Path)
    parser.add_argument("--budget", type=float, default=10.0)
    parser.add_argument("--faults", nargs="+", choices=NAMES, default=NAMES)
    args = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as spare:
        folder = args.models or Path(spare)
        folder.mkdir(parents=True, exist_ok=True)
        for kind in args.kinds or ("narx", "greybox"):
            drives: list[Said] = []
            when: list[int] = []
            false = n = 0
            for vehicle in range(args.first_vehicle, args.first_vehicle + args.vehicles):
                bench, each = Bench(vehicle, kind, folder, args.budget), list(cases(args.faults))
                verdicts = bench.judged(each)
                drives += [said(vehicle, *pair) for pair in zip(each, verdicts, strict=True)]
                if set(OFFSETS) <= set(args.faults):
                    drive, codes, taught = offsets(bench)
                    when, false, n = when + drive, false + codes, n + taught
            print(f"\n{kind}")
            table(drives)
            by = [sum(0 < each <= k + 1 for each in when) for k in range(OFFSET_DRIVES)]
            print(f"offsets after {TAUGHT} healthy drives: named by drive 1, 2, 3: {by}", end="")
            print(f" of {len(when)}; {false} of {n} healthy drives before have a code", flush=True)
    return 0
