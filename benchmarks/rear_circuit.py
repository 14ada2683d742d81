"""Circuit and heater of the downstream sensor on simulated vehicles on which nothing was chosen.

    python benchmarks/rear_circuit.py [--sound 50] [--faulty 12]

Vehicles from 2501 on, 400 s each, three cycles; with and without fuel cuts and active steps. Every
fifth sound sensor stands behind an empty can. All numbers are simulated.
"""

import argparse
from collections import Counter
from typing import Final

import numpy as np
from catalyst import CIRCUIT

from monitor.base import config
from monitor.judge.rear_circuit import RearCircuit
from training.studies.catalyst.cases import CYCLES, MODES, PERIOD_S, Case, drive

FIRST: Final = 2501
SECONDS: Final = 400.0
OTHERS: Final = ("downstream_stuck_lean", "downstream_weak")  # no faults of the circuit


def judged(vehicle: int, cycle: str, case: Case) -> tuple[tuple[str, ...], float | None]:
    """Return the faults that were ever named, and after how long the sensor woke in s."""
    names, values, _ = drive(vehicle, cycle, case, SECONDS)
    column = dict(zip(names, values.T, strict=True))
    circuit = RearCircuit(config.shipped().catalyst, PERIOD_S)
    found, _ = circuit.push(
        volts=column["downstream_voltage_v"],
        x=1.0 - 1.0 / np.maximum(column["lambda_measured"], 0.1),
        air_g_s=column["maf_kg_h"] / 3.6,
        running=np.arange(1.0, len(values) + 1.0),
        duty_percent=column["downstream_heater_percent"],
    )
    return tuple(sorted({each.fault for each in found if each.fault})), circuit.wake_s


def main() -> None:
    """Judge each fault on its vehicles; print what was named and when the sensors woke."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sound", type=int, default=50)
    parser.add_argument("--faulty", type=int, default=12)
    args = parser.parse_args()
    for fault in ("", *CIRCUIT, *OTHERS):
        named: Counter[str] = Counter()
        wakes = []
        for i in range(args.faulty if fault else args.sound):
            empty = 0.02 if not fault and i % 5 == 0 else None
            case = Case("circuit", empty, sensor=fault, mode=MODES[i % len(MODES)])
            faults, wake_s = judged(FIRST + i, CYCLES[i // 3 % 3], case)
            named[", ".join(faults) or "none"] += 1
            wakes += [wake_s] if wake_s else []
        woke = f"{min(wakes):.0f} to {max(wakes):.0f} s" if wakes else "-"
        print(f"{fault or 'sound'}: {dict(named)}, woke after {woke}", flush=True)


if __name__ == "__main__":
    main()
