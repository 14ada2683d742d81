"""The catalyst monitor on an engine and a catalyst of other equations than its own.

    python benchmarks/catalyst_second_engine.py [--vehicles 12] [--first 101]

``tests/helpers/second_catalyst.py``: ceria with a slow bulk, rates of reaction that let gas pass at
high flow, a sensor with hysteresis, another outer control. Ten minutes each, 10 Hz. All numbers are
simulated.
"""

import argparse
from typing import Final

import numpy as np

from benchmarks.catalyst import judged
from benchmarks.catalyst_matrix import exact
from tests.helpers import second_catalyst

CASES: Final = (  # capacity in g, lag of the rear sensor in s, offset of the front sensor, leak
    (0.03, 0.0, 0.0, 0.0),
    (0.06, 0.0, 0.0, 0.0),
    (0.06, 1.5, 0.0, 0.0),
    (0.25, 0.0, 0.0, 0.0),
    (0.25, 1.5, 0.0, 0.0),
    (0.6, 0.0, 0.0, 0.0),
    (0.4, 0.0, 0.02, 0.0),
    (0.4, 0.0, -0.02, 0.0),
    (0.4, 0.0, 0.0, 0.02),
)


def main() -> None:
    """Judge every case on every vehicle; print one line per case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicles", type=int, default=12)
    parser.add_argument("--first", type=int, default=101)
    args = parser.parse_args()
    vehicles = range(args.first, args.first + args.vehicles)
    for grams, lag_s, offset, leak in CASES:
        rows = []
        for vehicle in vehicles:
            own = second_catalyst.brick(vehicle, grams)._replace(leak=leak)
            values = second_catalyst.drive(vehicle, vehicle, own, lag_s, offset)
            rows.append(judged(second_catalyst.NAMES, values))
        n = len(rows)
        said = [f"{row['sensor'] or 'sound'}, {row['balance'] or 'balanced'}" for row in rows]
        estimates = [row["capacity_g"] for row in rows if row["capacity_g"]]
        times = [row["decided_s"] for row in rows if row["decided_s"]]
        print(
            f"{grams:g} g, rear lag {lag_s:g} s, offset {offset:+g}, leak {leak:g}: "
            f"failed {exact(sum(row['ever_failed'] for row in rows), n)}, "
            f"passed {exact(sum(row['ever_passed'] for row in rows), n)}, "
            f"capacity {np.median(estimates):.3f} g (median), "
            f"time {np.median(times) if times else np.nan:.0f} s, "
            f"{ {each: said.count(each) for each in dict.fromkeys(said)} }",
            flush=True,
        )


if __name__ == "__main__":
    main()
