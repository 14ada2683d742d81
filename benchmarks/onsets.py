"""Faults of simulated vehicles that begin after healthy driving: when does the code come?

    python benchmarks/onsets.py offsets FIRST_VEHICLE VEHICLES
    python benchmarks/onsets.py late FIRST_VEHICLE VEHICLES

``offsets``: three healthy drives teach the vehicle's reference, then the sensor reads 0.05 lean or
rich for up to three drives. Every drive has its own fuel from E0 to E10 and its own weather.
``late``: the eight response faults at their limit severities, two a vehicle in turn, from the start
of a WLTC and from 700 s on, without a reference.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

import monitor
from monitor.base import faults
from monitor.base.config import load
from monitor.base.types import SampleBlock
from monitor.judge.limits import Limits
from monitor.memory.reference import Reference
from monitor.model.step import Model
from monitor.pipeline.side_by_side import Judged
from training.dyno import ecu
from training.dyno.effects import Effects
from training.dyno.simulation import Experiment, simulate
from training.limits.targets import LIMIT_SEVERITY
from training.studies.matrix.conditions import AMBIENTS, weather
from training.studies.matrix.plan import MOST_ETHANOL
from training.studies.matrix.verdicts import judge_drives, learn

MODEL: Final = Path(monitor.__file__).parent / "model" / "shipped.onnx"
CYCLES: Final = ("wltc_3b", "micro_trips")
ONSETS_S: Final = (0.0, 700.0)
OFFSET_LAMBDA: Final = 0.05
DRIVES: Final = 3  # healthy ones, then with the offset


class Bench:
    """Simulated drives and the shipped monitor."""

    def __init__(self) -> None:
        self._model, self._bus, self.config = Model.load(MODEL), ecu.own_bus(), load()
        self._limits = Limits.from_card(self._model.card, self.config, MODEL.name)
        self.period_s = self._model.card.period_ns * 1e-9

    def samples(
        self,
        vehicle: int,
        number: int,
        cycle: str,
        ambient: str,
        fault: str = "",
        start_s: float = 0.0,
    ) -> SampleBlock:
        """Return a drive's samples; ``number`` draws driver, noise, weather and fuel."""
        severity = OFFSET_LAMBDA if fault.startswith("biased") else LIMIT_SEVERITY.get(fault)
        broken = faults.resolve(fault, severity) if fault else None
        seed = 100 * vehicle + number
        ethanol = np.random.default_rng([0x0_2, 11, seed]).uniform(0.0, MOST_ETHANOL)
        drive = Experiment(
            cycle,
            vehicle,
            seed,
            broken,
            start_s,
            effects=Effects(ethanol=float(ethanol)),
            conditions=weather(ambient, seed),
        )
        rng = np.random.default_rng([0x0_2, 5, seed, vehicle])
        frames = ecu.broadcast(simulate(drive), self._bus, rng, broken, start_s)
        return ecu.samples(frames, self._bus, self._model.card.period_ns)

    def judged(self, block: SampleBlock, reference: Reference | None = None) -> Judged:
        """Return the verdict on a drive with an empty fault memory."""
        return judge_drives(
            [block], self._bus.names, self._model, self._limits, self.config, [reference]
        )[0]


def offsets(bench: Bench, vehicles: range) -> None:
    """Print how many offsets have their code by the end of each drive."""
    found, false = np.zeros(DRIVES, dtype=int), 0
    for i, vehicle in enumerate(vehicles):
        known: Reference | None = None
        for k in range(DRIVES):
            ambient = AMBIENTS[(i + k // 2) % len(AMBIENTS)]
            judged = bench.judged(bench.samples(vehicle, k, CYCLES[(i + k) % 2], ambient), known)
            false += bool(judged.dtcs)
            known = learn(known, judged, bench.config)
        for fault, first in (("biased_lean", 10), ("biased_rich", 20)):
            found += found_in(bench, vehicle, i, fault, first, known)
    print(f"{false} of {DRIVES * len(vehicles)} healthy drives have a code")
    for k, n in enumerate(found, 1):
        print(f"offset named by the end of drive {k}: {n} of {2 * len(vehicles)}")


def found_in(
    bench: Bench, vehicle: int, i: int, fault: str, first: int, known: Reference | None
) -> NDArray[np.int_]:
    """Return for each drive with the offset whether its code came by then."""
    found = np.zeros(DRIVES, dtype=int)
    for k in range(DRIVES):
        ambient = AMBIENTS[(i + (first + k) // 2) % len(AMBIENTS)]
        block = bench.samples(vehicle, first + k, "wltc_3b", ambient, fault)
        judged = bench.judged(block, known)
        if any(dtc.fault == fault for dtc in judged.dtcs):
            found[k:] = 1
            break
        known = learn(known, judged, bench.config)
    return found


def late(bench: Bench, vehicles: range) -> None:
    """Print enabled time from each onset to the code."""
    names = [name for name in LIMIT_SEVERITY if not name.startswith("biased")]
    for start_s in ONSETS_S:
        times, named, n = [], 0, 0
        for vehicle, number, fault in each_fault(vehicles, names):
            block = bench.samples(vehicle, number, "wltc_3b", "mild", fault, start_s)
            judged = bench.judged(block)
            n += 1
            begin_ns = int(block.t_ns[0]) + round(start_s * 1e9)
            code_ns = min((dtc.t_ns for dtc in judged.dtcs), default=-1)
            if code_ns < begin_ns:
                continue
            named += any(dtc.fault == fault for dtc in judged.dtcs)
            between = (block.t_ns > begin_ns) & (block.t_ns <= code_ns)
            times.append(bench.period_s * np.count_nonzero(judged.enabled & between))
        median, slow = np.median(times), np.quantile(times, 0.9)
        print(
            f"from {start_s:g} s on: {len(times)} of {n} found, {named} named, enabled time to "
            f"the code {median:.1f} s, 90 % within {slow:.1f} s"
        )


def each_fault(vehicles: range, names: list[str]) -> Iterator[tuple[int, int, str]]:
    """Yield vehicle, number and fault of two drives a vehicle, through all faults in turn."""
    for i, vehicle in enumerate(vehicles):
        for number in range(2):
            yield vehicle, number, names[(2 * i + number) % len(names)]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("what", choices=("offsets", "late"))
    parser.add_argument("first_vehicle", type=int)
    parser.add_argument("vehicles", type=int)
    args = parser.parse_args()
    vehicles = range(args.first_vehicle, args.first_vehicle + args.vehicles)
    (offsets if args.what == "offsets" else late)(Bench(), vehicles)


if __name__ == "__main__":
    main()
