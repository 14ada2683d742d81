"""The sensor's span in fuel cuts at sea level and up a mountain, with and without the pressure.

Simulated: an ECU whose reading has a level in air (2.0). Its sensor's reading depends on pressure
in the form of the dynamometer, linear in bar (``back_pressure``), which takes 10 % at 75 kPa; or
the ECU corrects it. Eight healthy drives of one vehicle are the reference: at the pressures that
the dynamometer draws (about 98.5 kPa), or at 75 to 102 kPa. Further drives of the vehicle have
other seeds. ``known`` has the signal of the ambient pressure, ``unknown`` has not.

    python benchmarks/air_pressure.py FIRST_SEED [--vehicle N] [--drives N]
"""

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from monitor.base import config, faults
from monitor.base.faults import Fault
from monitor.judge.fuel_cut import LEVEL, Cut, Stretch, cuts_of
from monitor.judge.fuel_cut_response import FuelCutReference, FuelCutResponse
from training.dyno import vehicle
from training.dyno.effects import from_severities
from training.dyno.simulation import Experiment, simulate
from training.limits.fuel_cuts import reference_of

CONFIG: Final = config.load()
PERIOD_S, EVERY, LEAST_PHI = 0.1, 10, 0.05  # of the samples; samples of 100 Hz; least step
TEN_PERCENT_AT_75: Final = 0.75  # severity of back_pressure
GAINS: Final = (1.0, 0.85, 0.6)
MOUNTAIN_KPA, SEA_KPA = 75.0, 100.0


def cuts(number: int, seed: int, severity: float, kpa: float | None, gain: float) -> list[Cut]:
    """Return the fuel cuts of a drive."""
    conditions = vehicle.conditions(seed)._replace(coolant_start_degc=85.0)
    if kpa is not None:
        conditions = conditions._replace(ambient_kpa=kpa)
    drive = simulate(
        Experiment(
            "wltc_3b",
            vehicle=number,
            seed=seed,
            fault=faults.resolve("gain_low", gain) if gain < 1.0 else Fault("healthy", 0.0),
            conditions=conditions,
            effects=from_severities({"back_pressure": severity} if severity else {}),
            linear_reading=True,
        )
    )
    phi = 1.0 / drive["lambda_measured"][::EVERY]
    usable = np.isfinite(phi)
    is_cut = (drive["fuel_cut"][::EVERY] > 0.5) & usable
    t_ns = np.arange(len(phi)) * int(PERIOD_S * 1e9)
    stretch = Stretch(t_ns[usable], phi[usable], phi[usable], is_cut[usable])
    found = cuts_of(stretch, CONFIG.fuel_cut, PERIOD_S, LEAST_PHI)
    return [replace(cut, pressure_kpa=conditions.ambient_kpa) for cut in found]


def without_pressure(drive: Sequence[Cut]) -> list[Cut]:
    return [replace(cut, pressure_kpa=math.nan) for cut in drive]


def judged(drive: Sequence[Cut], reference: FuelCutReference | None) -> tuple[float, float, str]:
    """Return gain, its standard deviation and the verdict on the level."""
    test = FuelCutResponse(CONFIG, reference, "phi")
    for cut in drive:
        test.add(cut)
    assert test.gain is not None
    return (*test.gain, test.findings()[LEVEL].verdict)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("first_seed", type=int)
    parser.add_argument("--vehicle", type=int, default=1)
    parser.add_argument("--drives", type=int, default=6)
    args = parser.parse_args()
    print("| reading, reference | share | pressure | kPa | gain | measured | std | verdicts |")
    print("|---|---|---|---|---|---|---|---|")
    for title, severity in (("uncorrected", TEN_PERCENT_AT_75), ("corrected", 0.0)):
        seeds = iter(range(args.first_seed, args.first_seed + 1000))
        levels = np.linspace(75.0, 102.0, 8).tolist()
        drawn = [cuts(args.vehicle, next(seeds), severity, None, 1.0) for _ in range(8)]
        spread = [cuts(args.vehicle, next(seeds), severity, kpa, 1.0) for kpa in levels]
        drives = {
            (kpa, gain): [
                cuts(args.vehicle, next(seeds), severity, kpa, gain) for _ in range(args.drives)
            ]
            for kpa in (SEA_KPA, MOUNTAIN_KPA)
            for gain in GAINS
        }
        for about, own in (("98.5 kPa", drawn), ("75 to 102 kPa", spread)):
            for knows in (True, False):
                learned = own if knows else [without_pressure(each) for each in own]
                reference = reference_of(learned, CONFIG, "phi", PERIOD_S)
                told = reference.pressure if reference else None
                share = f"{told.share:.2f} ± {told.share_std:.2f}" if told else "-"
                for (kpa, gain), group in drives.items():
                    found = [
                        judged(each if knows else without_pressure(each), reference)
                        for each in group
                    ]
                    gains, stds, verdicts = zip(*found, strict=True)
                    count = ", ".join(f"{verdicts.count(v)} {v}" for v in dict.fromkeys(verdicts))
                    print(
                        f"| {title}, {about} | {share} | {'known' if knows else 'unknown'} | "
                        f"{kpa:g} | {gain:g} | {min(gains):.3f} to {max(gains):.3f} | "
                        f"{np.mean(stds):.3f} | {count} |"
                    )


if __name__ == "__main__":
    main()
