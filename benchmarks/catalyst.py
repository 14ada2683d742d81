"""How well the catalyst monitor judges simulated vehicles on which nothing was chosen.

    python benchmarks/catalyst.py [--vehicles 12] [--duration 700] [--period 0.1] [--out rows.jsonl]

Vehicles from 32001 on, one seed each, three cycles in turn; the drive passes through the simulated
ECU's messages. All numbers are simulated.
"""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from monitor.base import config
from training.studies.catalyst.cases import BIAS_LAMBDA, CYCLES, PERIOD_S, Case, drive, judged
from training.studies.catalyst.tables import estimates

FIRST_VEHICLE: Final = 32_001
CAPACITIES_G: Final = (0.03, 0.06, 0.25, 0.4)
SENSORS: Final = (
    "downstream_slow_symmetric",
    "downstream_slow_rich_to_lean",
    "downstream_slow_lean_to_rich",
    "downstream_delay_symmetric",
    "downstream_weak",
    "downstream_stuck_rich",
)


CIRCUIT: Final = ("downstream_low", "downstream_high", "downstream_inactive", "downstream_heater")
UPSTREAM: Final = ("biased_lean", "biased_rich")
LEAK: Final = 0.02  # of the exhaust, at idle
SULPHUR: Final = 0.3  # of the capacity is blocked at the start
ETHANOL_PERCENT: Final = 10.0


def cases() -> Iterator[Case]:
    """Yield every case."""
    yield Case("sound")
    for grams in CAPACITIES_G:
        yield Case(f"capacity_{grams:g}", grams)
    for name in SENSORS[:3]:
        yield Case(f"0.06 and {name}", 0.06, name)
    for name in (*SENSORS, *CIRCUIT):
        yield Case(name, sensor=name)
    for name in UPSTREAM:
        yield Case(f"{name} {BIAS_LAMBDA:g}", upstream=name)
    yield Case("leak between the sensors", leak=LEAK)
    yield Case("0.06 and leak", 0.06, leak=LEAK)
    yield Case("sulphur", sulphur=SULPHUR)
    yield Case("0.25 and sulphur", 0.25, sulphur=SULPHUR)
    yield Case("10 % ethanol", ethanol=ETHANOL_PERCENT)


def main() -> None:
    """Judge every case on every vehicle; write one line of JSON each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicles", type=int, default=12)
    parser.add_argument("--duration", type=float, default=700.0)
    parser.add_argument("--period", type=float, default=PERIOD_S, help="of the samples in s")
    parser.add_argument("--out", type=Path, default=Path("catalyst.jsonl"))
    args = parser.parse_args()
    settings = config.load()
    with args.out.open("w") as file:
        for i in range(args.vehicles):
            vehicle, cycle = FIRST_VEHICLE + i, CYCLES[i % len(CYCLES)]
            for case in cases():
                names, values, true_g = drive(
                    vehicle, cycle, case, args.duration, period_s=args.period
                )
                row = {"vehicle": vehicle, "cycle": cycle, "case": case.name, "true_g": true_g}
                file.write(json.dumps(row | judged(names, values, settings, args.period)) + "\n")
                file.flush()
    report([json.loads(line) for line in args.out.read_text().splitlines()])


def report(rows: list[dict[str, Any]]) -> None:
    """Print one line per case."""
    print(f"{'case':<36}{'n':>4}{'failed':>8}{'passed':>8}{'open':>6}{'median s':>10}  other names")
    for case in dict.fromkeys(row["case"] for row in rows):
        own = [row for row in rows if row["case"] == case]
        times = [row["decided_s"] for row in own if row["decided_s"] is not None]
        named = [
            " + ".join(fault for test, fault in row["faults"].items() if test != "catalyst")
            or "none"
            for row in own
        ]
        counts = {n: named.count(n) for n in dict.fromkeys(named)}
        failed, passed = (sum("catalyst" in r[k] for r in own) for k in ("faults", "passed_s"))
        print(
            f"{case:<36}{len(own):>4}{failed:>8}{passed:>8}{len(own) - len(times):>6}"
            f"{np.median(times) if times else np.nan:>10.0f}  {counts}"
        )
    plain = {"sound", *(f"capacity_{grams:g}" for grams in CAPACITIES_G)}
    sound = [r for r in rows if r["case"] in plain and r["true_g"] >= 0.1]
    found = estimates(sound)
    covered = found["covered"]
    print(
        f"capacity of {len(sound)} drives at 0.1 g and above without a sensor fault: mean error "
        f"{100 * found['bias']:+.0f} %, spread {100 * found['spread']:.0f} %, the 90 % interval "
        f"covers {covered['events']} of {covered['trials']}"
    )


if __name__ == "__main__":
    main()
