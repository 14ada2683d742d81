"""How well the catalyst monitor judges simulated vehicles on which nothing was chosen.

    python benchmarks/catalyst.py [--vehicles 12] [--duration 700] [--out rows.jsonl]

Vehicles from 301 on, one seed each, three cycles in turn; the drive passes through the simulated
ECU's messages. All numbers are simulated.
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from monitor.base import config, downstream_faults, faults
from monitor.base.types import FloatArray
from monitor.judge.catalyst import CatalystMonitor
from training.dyno import catalyst, ecu, effects
from training.dyno.simulation import Experiment, simulate
from training.dyno.vehicle import conditions, piece

FIRST_VEHICLE: Final = 301
CYCLES: Final = ("wltc_3b", "udds", "micro_trips")
PERIOD_S: Final = 0.1
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
BIAS_LAMBDA: Final = 0.02
LEAK: Final = 0.02  # of the exhaust, at idle
ETHANOL_PERCENT: Final = 10.0
STEPS_PHI: Final = 0.03


@dataclass(frozen=True, slots=True)
class Case:
    """A fault of catalyst, sensors or exhaust; the vehicle's own parts otherwise."""

    name: str
    grams: float | None = None
    sensor: str = ""  # fault of the downstream sensor
    upstream: str = ""  # fault of the upstream sensor
    leak: float = 0.0
    ethanol: float = 0.0  # percent
    bias_lambda: float = BIAS_LAMBDA
    sensor_severity: float | None = None
    mode: str = "cut"  # "passive": no fuel cut, "active": fuel cut and the ECU's own steps
    meter: float = 1.0  # factor on the air meter
    injector: float = 1.0  # factor on the injectors


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
    yield Case("10 % ethanol", ethanol=ETHANOL_PERCENT)


def drive(
    vehicle: int, cycle: str, case: Case, duration_s: float
) -> tuple[tuple[str, ...], FloatArray, float]:
    """Return names, samples (n, n_names) and true capacity in g of one drive."""
    own = catalyst.piece(vehicle).capacity_g
    weather = conditions(vehicle)._replace(overrun_cut=float(case.mode != "passive"))
    parts = piece(vehicle)
    parts = parts._replace(
        maf_gain=parts.maf_gain * case.meter, injector_gain=parts.injector_gain * case.injector
    )
    healthy = downstream_faults.DownstreamFault("", 0.0)
    fault = downstream_faults.resolve(case.sensor, case.sensor_severity) if case.sensor else healthy
    fault = replace(fault, capacity_g=case.grams or own, leak=case.leak)
    signals = simulate(
        Experiment(
            cycle=cycle,
            vehicle=vehicle,
            seed=vehicle,
            duration_s=duration_s,
            downstream=True,
            downstream_fault=fault,
            fault=faults.resolve(case.upstream, case.bias_lambda) if case.upstream else None,
            effects=effects.from_severities({"ethanol": case.ethanol}),
            conditions=weather,
            piece=parts,
            active_steps_phi=STEPS_PHI if case.mode == "active" else 0.0,
        )
    )
    bus_map = ecu.own_bus()
    sent = ecu.broadcast(signals, bus_map, np.random.default_rng(vehicle))
    block = ecu.samples(sent, bus_map, round(PERIOD_S * 1e9))
    return ecu.names_of(sent, bus_map), block.values, case.grams or own


def judged(names: tuple[str, ...], values: FloatArray) -> dict[str, Any]:
    """Return what the monitor says at the end, and when it first decided on the catalyst."""
    monitor = CatalystMonitor(config.shipped().catalyst, names, PERIOD_S)
    first_s, verdicts, in_a_row, sensors = None, [], 0, []
    decided, circuit = None, set()
    for result in monitor.push(values, np.ones(len(values), dtype=np.bool_)):
        if result.test != "catalyst":
            if result.test == "downstream":
                sensors.append(result.claim.fault)
            elif result.test.startswith("downstream_") and result.claim.fault:
                circuit.add(result.claim.fault)
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
        "circuit": sorted(circuit),
        "balance": rule.balance().fault if rule else None,
        "sensor_ever": sorted({a for a, b in pairwise(sensors) if a == b and a}),
    }


def main() -> None:
    """Judge every case on every vehicle; write one line of JSON each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicles", type=int, default=12)
    parser.add_argument("--duration", type=float, default=700.0)
    parser.add_argument("--out", type=Path, default=Path("catalyst.jsonl"))
    args = parser.parse_args()
    with args.out.open("w") as file:
        for i in range(args.vehicles):
            vehicle, cycle = FIRST_VEHICLE + i, CYCLES[i % len(CYCLES)]
            for case in cases():
                names, values, true_g = drive(vehicle, cycle, case, args.duration)
                row = {"vehicle": vehicle, "cycle": cycle, "case": case.name, "true_g": true_g}
                file.write(json.dumps(row | judged(names, values)) + "\n")
                file.flush()
    report([json.loads(line) for line in args.out.read_text().splitlines()])


def report(rows: list[dict[str, Any]]) -> None:
    """Print one line per case."""
    print(f"{'case':<36}{'n':>4}{'failed':>8}{'passed':>8}{'open':>6}{'median s':>10}  sensor")
    for case in dict.fromkeys(row["case"] for row in rows):
        own = [row for row in rows if row["case"] == case]
        times = [row["decided_s"] for row in own if row["decided_s"] is not None]
        named = [
            f"{', '.join(row['circuit']) or row['sensor'] or 'sound'}, "
            f"{row['balance'] or 'balanced'}"
            for row in own
        ]
        counts = {n: named.count(n) for n in dict.fromkeys(named)}
        print(
            f"{case:<36}{len(own):>4}{sum(r['ever_failed'] for r in own):>8}"
            f"{sum(r['ever_passed'] for r in own):>8}{sum(r['decided'] is None for r in own):>6}"
            f"{np.median(times) if times else np.nan:>10.0f}  {counts}"
        )
    plain = {"sound", *(f"capacity_{grams:g}" for grams in CAPACITIES_G)}
    sound = [r for r in rows if r["case"] in plain and r["true_g"] >= 0.1]
    error = np.array([r["capacity_g"] / r["true_g"] - 1.0 for r in sound])
    inside = [r["capacity_low_g"] <= r["true_g"] <= (r["capacity_high_g"] or np.inf) for r in sound]
    print(
        f"capacity of {len(sound)} drives at 0.1 g and above without a sensor fault: mean error "
        f"{100 * error.mean():+.0f} %, root mean square {100 * np.sqrt((error**2).mean()):.0f} %, "
        f"the 90 % interval covers {100 * np.mean(inside):.0f} %"
    )


if __name__ == "__main__":
    main()
