"""The naming on vehicles of the tests' second engine, with effects and with faults.

All drives are simulated, by other equations than those of the dynamometer and the library.

    python -m benchmarks gap_second_engine --vehicles 11 12
"""

import argparse
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from joblib import Parallel, delayed

from benchmarks.studies.second.engine import SOUND, Sensor, drive
from training.gap.healthy.behaviour import Healthy
from training.gap.name import yardstick
from training.gap.name.naming import name
from training.greybox.chain import Constants

HEALTHY_DRIVES, DRIVES, NULLS = 8, 6, 5
SIZES = {
    "wall_film": 1.5,
    "delay_flow": 5.0,
    "mix_flow": 5.0,
    "sensor_asymmetry": 3.0,
    "injector_offset": 2.0,
    "rail_exponent": 2.0,
    "maf_offset": 1.0,
    "maf_pulsation": 1.5,
    "purge": 12.0,
    "exhaust_leak": 6.0,
    "back_pressure": 4.0,
    "scavenging": 1.5,
    "fuel_cut_tail": 4.0,
    "manifold_filling": 6.0,
    "ethanol": 3.0,
}
FAULTS = {
    "slow by 0.25 s": Sensor(lag_s=0.25),
    "late by 0.2 s": Sensor(dead_time_s=0.2),
    "gain of 0.8": Sensor(gain=0.8),
    "offset of 0.03": Sensor(offset_lambda=0.03),
}
ONSETS = {
    "slow by 0.4 s": Sensor(lag_s=0.4),
    "late by 0.3 s": Sensor(dead_time_s=0.3),
    "gain of 0.7": Sensor(gain=0.7),
    "offset of 0.05": Sensor(offset_lambda=0.05),
}
ONSET_DRIVE, ONSET_S = 2, 300.0  # of the drives in their order, and within that drive


class Case(NamedTuple):
    """What a vehicle has and from when on."""

    kind: str
    what: str
    size: float = 0.0
    sensor: Sensor = SOUND
    from_drive: int = 0


def cases() -> Iterator[Case]:
    """Yield what is tried on each vehicle."""
    for number in range(NULLS):
        yield Case("nothing", f"drives {number + 1}")
    for effect, size in SIZES.items():
        yield Case("effect", effect, size)
    for what, sensor in FAULTS.items():
        yield Case("fault from the start", what, sensor=sensor)
    for what, sensor in ONSETS.items():
        yield Case("fault with an onset", what, sensor=sensor, from_drive=ONSET_DRIVE)


def answer(vehicle: int, number: int, case: Case, known: Healthy) -> str:
    """Return verdict and names."""
    hidden = {case.what: case.size} if case.size else {}
    driven = []
    for i in range(DRIVES):
        sensor = case.sensor if i >= case.from_drive else SOUND
        if case.from_drive and i == case.from_drive:
            sensor = sensor._replace(start_s=ONSET_S)
        driven.append(drive(vehicle, 1000 * vehicle + 100 + 10 * number + i, hidden, sensor))
    found = name(driven, known)
    return " ".join([found.verdict, *(each.name for each in found.answer.effects)])


def main(argv: Sequence[str]) -> int:
    """Print every answer."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicles", type=int, nargs="+", default=[11, 12])
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args(argv)
    for vehicle in args.vehicles:
        healthy = [drive(vehicle, 1000 * vehicle + i) for i in range(HEALTHY_DRIVES)]
        known = yardstick.learn(healthy, Constants())
        each = list(cases())
        said = Parallel(args.jobs)(
            delayed(answer)(vehicle, number, case, known) for number, case in enumerate(each)
        )
        for case, words in zip(each, said, strict=True):
            print(f"vehicle {vehicle}  {case.kind}: {case.what}: {words}", flush=True)
    return 0
