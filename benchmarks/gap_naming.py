"""What the gap workflow names on simulated vehicles: hidden effects, nothing, sensor faults.

Everything is simulated. Per case two drives of ten minutes at 10 Hz; the vehicle's healthy
behaviour comes from four others. Vehicles 2000 to 2999 serve development.
"""

import argparse
import time
from collections import Counter

import numpy as np

from monitor.faults import Fault, resolve
from training.chain import Constants
from training.dyno.ecu import broadcast, own_bus, samples
from training.dyno.effects import from_severities
from training.dyno.simulate import Experiment, simulate
from training.gap import drives
from training.gap.drives import Drive
from training.gap.effects import LIBRARY
from training.gap.healthy import Healthy, learn
from training.gap.naming import name

CYCLES = ("micro_trips", "wltc_3b")
HEALTHY_CYCLES = ("wltc_3b", "micro_trips", "udds", "us06")
LARGEST = {"sensor_asymmetry": 1.5}  # the plant's form gives no more
UNKNOWN = ("oil_dilution", "battery_voltage", "intake_resonance")
FAULTS = (
    ("slow_symmetric", 0.3, 0.0),
    ("gain_low", 0.7, 300.0),
    ("biased_lean", 0.03, 0.0),
    ("delay_rich_to_lean", 0.3, 250.0),
    ("slow_rich_to_lean", 0.4, 0.0),
)


def drive(
    cycle: str,
    vehicle: int,
    seed: int,
    effects: dict[str, float],
    fault: Fault | None = None,
    start_s: float = 0.0,
) -> Drive:
    experiment = Experiment(
        cycle=cycle,
        vehicle=vehicle,
        seed=seed,
        effects=from_severities(effects),
        fault=fault,
        fault_start_s=start_s,
        duration_s=600.0,
    )
    bus = own_bus()
    rng = np.random.default_rng([5, seed])
    sent = broadcast(simulate(experiment), bus, rng, fault, start_s)
    values = samples(sent, bus, 100_000_000).values
    columns = {each: values[:, i] for i, each in enumerate(bus.names)}
    measured = columns.pop("lambda_measured")
    return drives.make(experiment.name, str(seed), 0.1, columns, measured)


def case(
    vehicle: int,
    known: Healthy,
    number: int,
    effects: dict[str, float],
    fault: Fault | None = None,
    start_s: float = 0.0,
) -> tuple[str, str]:
    """Return the verdict, and names or suspicion with figures."""
    seed = 2_000_100 + 2 * number + 100 * vehicle
    driven = [drive(c, vehicle, seed + i, effects, fault, start_s) for i, c in enumerate(CYCLES)]
    began = time.perf_counter()
    found = name(driven, known)
    took_s = time.perf_counter() - began
    names = ", ".join(effect.name for effect in found.effects) or found.suspected or ""
    after = "" if found.rmse_after is None else f" → {found.rmse_after:.4f}"
    figures = f"RMSE {found.rmse_before:.4f}{after}, floor {found.noise_floor:.4f}, {took_s:.1f} s"
    return found.verdict, f"{names} ({figures})"


Planned = tuple[str, str, int, dict[str, float], Fault | None, float]


def plan(arguments: argparse.Namespace) -> list[Planned]:
    """Return kind, words, number, effects, fault and its start of every case."""
    sizes = {each: min(arguments.severity, LARGEST.get(each, np.inf)) for each in LIBRARY}
    return [
        *(("null", "null", 10 + i, {}, None, 0.0) for i in range(arguments.nulls)),
        *(("effect", e, 20 + i, {e: size}, None, 0.0) for i, (e, size) in enumerate(sizes.items())),
        *(
            ("fault", f"{fault} @{start_s:g}", 40 + i, {}, resolve(fault, size), start_s)
            for i, (fault, size, start_s) in enumerate(FAULTS)
        ),
        *(("unknown", e, 50, {e: arguments.severity}, None, 0.0) for e in UNKNOWN),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicles", type=int, nargs="+", default=[2002, 2003])
    parser.add_argument("--severity", type=float, default=4.0)
    parser.add_argument("--nulls", type=int, default=4)
    arguments = parser.parse_args()
    rates: Counter[tuple[str, str]] = Counter()
    for vehicle in arguments.vehicles:
        seeds = enumerate(HEALTHY_CYCLES, 2_000_001 + 10 * vehicle)
        known = learn([drive(c, vehicle, seed, {}) for seed, c in seeds], Constants())
        for kind, what, number, effects, failure, start_s in plan(arguments):
            verdict, words = case(vehicle, known, number, effects, failure, start_s)
            outcome = verdict
            if verdict == "named":
                outcome = "named right" if words.startswith(f"{what} ") else "named WRONG"
            rates[kind, outcome] += 1
            print(f"vehicle {vehicle}, {what:28s} {verdict:22s} {words}", flush=True)
    print()
    for (kind, outcome), count in sorted(rates.items()):
        print(f"{kind:8s} {outcome:24s} {count}")


if __name__ == "__main__":
    main()
