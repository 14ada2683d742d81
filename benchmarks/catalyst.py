"""How well the catalyst monitor judges simulated vehicles on which nothing was chosen.

    python benchmarks/catalyst.py [--vehicles 12] [--duration 900] [--out rows.jsonl]

Vehicles from 301 on, one seed each, three cycles in turn; the drive passes through the simulated
ECU's messages. All numbers are simulated.
"""

import argparse
import json
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from monitor.base import config, downstream_faults
from monitor.judge.catalyst import CatalystMonitor
from training.dyno import catalyst, ecu
from training.dyno.simulation import Experiment, simulate

FIRST_VEHICLE: Final = 301
CYCLES: Final = ("wltc_3b", "udds", "micro_trips")
PERIOD_S: Final = 0.1
CAPACITIES_G: Final = (0.03, 0.06, 0.25, 0.4)
SLOW_S: Final = 1.5
SENSORS: Final = (
    "downstream_slow_symmetric",
    "downstream_slow_rich_to_lean",
    "downstream_slow_lean_to_rich",
    "downstream_delay_symmetric",
    "downstream_weak",
    "downstream_stuck_rich",
)


def cases() -> Iterator[tuple[str, float | None, str | None]]:
    """Yield fault, capacity in g (None: the vehicle's own) and sensor fault of each case."""
    yield "sound", None, None
    for grams in CAPACITIES_G:
        yield f"capacity_{grams:g}", grams, None
    for name in SENSORS[:3]:
        yield f"0.06 and {name}", 0.06, name
    for name in SENSORS:
        yield name, None, name


def drive(vehicle: int, cycle: str, grams: float | None, sensor: str | None, duration_s: float):
    """Return names, samples (n, n_names) and true capacity of one drive."""
    fault = (
        downstream_faults.resolve(sensor) if sensor else downstream_faults.DownstreamFault("", 0)
    )
    own = catalyst.piece(vehicle).capacity_g
    fault = downstream_faults.DownstreamFault(
        **{f: getattr(fault, f) for f in fault.__dataclass_fields__} | {"capacity_g": grams or own}
    )
    signals = simulate(
        Experiment(
            cycle=cycle,
            vehicle=vehicle,
            seed=vehicle,
            duration_s=duration_s,
            downstream=True,
            downstream_fault=fault,
        )
    )
    bus_map = ecu.own_bus()
    sent = ecu.broadcast(signals, bus_map, np.random.default_rng(vehicle))
    block = ecu.samples(sent, bus_map, round(PERIOD_S * 1e9))
    return ecu.names_of(sent, bus_map), block.values, grams or own


def judged(names: tuple[str, ...], values: np.ndarray) -> dict[str, Any]:
    """Return what the monitor says at the end, and when it first decided on the catalyst."""
    monitor = CatalystMonitor(config.shipped().catalyst, names, PERIOD_S, 500.0)
    first_s, verdicts, in_a_row, sensors = None, [], 0, []
    decided = None
    for result in monitor.push(values):
        if result.test == "downstream":
            sensors.append(result.claim.fault)
            continue
        outcome = result.claim.outcome
        in_a_row = in_a_row + 1 if verdicts and outcome == verdicts[-1] else 1
        verdicts.append(outcome)
        if decided is None and outcome != "inconclusive" and in_a_row == 2:
            decided, first_s = outcome, result.at * PERIOD_S
    found = monitor.entry() or {}
    rule = monitor.rule
    last = rule.sensor() if rule else None
    return found | {
        "decided": decided,
        "decided_s": first_s,
        "ever_failed": any(a == b == "failed" for a, b in pairwise(verdicts)),
        "ever_passed": any(a == b == "passed" for a, b in pairwise(verdicts)),
        "sensor": last.fault if last else None,
        "sensor_ever": sorted({a for a, b in pairwise(sensors) if a == b and a}),
    }


def main() -> None:
    """Judge every case on every vehicle; write one line of JSON each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicles", type=int, default=12)
    parser.add_argument("--duration", type=float, default=900.0)
    parser.add_argument("--out", type=Path, default=Path("catalyst.jsonl"))
    args = parser.parse_args()
    with args.out.open("w") as file:
        for i in range(args.vehicles):
            vehicle, cycle = FIRST_VEHICLE + i, CYCLES[i % len(CYCLES)]
            for name, grams, sensor in cases():
                names, values, true_g = drive(vehicle, cycle, grams, sensor, args.duration)
                row = {"vehicle": vehicle, "cycle": cycle, "case": name, "true_g": true_g}
                file.write(json.dumps(row | judged(names, values)) + "\n")
                file.flush()
    report([json.loads(line) for line in args.out.read_text().splitlines()])


def report(rows: list[dict[str, Any]]) -> None:
    """Print one line per case."""
    print(f"{'case':<36}{'n':>4}{'failed':>8}{'passed':>8}{'open':>6}{'median s':>10}  sensor")
    for case in dict.fromkeys(row["case"] for row in rows):
        own = [row for row in rows if row["case"] == case]
        times = [row["decided_s"] for row in own if row["decided_s"] is not None]
        named = [row["sensor"] for row in own]
        counts = {n: named.count(n) for n in dict.fromkeys(named)}
        print(
            f"{case:<36}{len(own):>4}{sum(r['ever_failed'] for r in own):>8}"
            f"{sum(r['ever_passed'] for r in own):>8}{sum(r['decided'] is None for r in own):>6}"
            f"{np.median(times) if times else np.nan:>10.0f}  {counts}"
        )
    sound = [r for r in rows if r["capacity_g"] and r["sensor"] is None and r["true_g"] >= 0.1]
    error = np.array([r["capacity_g"] / r["true_g"] - 1.0 for r in sound])
    inside = [r["capacity_low_g"] <= r["true_g"] <= (r["capacity_high_g"] or np.inf) for r in sound]
    print(
        f"capacity of {len(sound)} drives at 0.1 g and above without a sensor fault: mean error "
        f"{100 * error.mean():+.0f} %, root mean square {100 * np.sqrt((error**2).mean()):.0f} %, "
        f"the 90 % interval covers {100 * np.mean(inside):.0f} %"
    )


if __name__ == "__main__":
    main()
