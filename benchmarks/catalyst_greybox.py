"""The grey-box fit of a catalyst on simulated vehicles: estimates, standard errors and truth.

    python benchmarks/catalyst_greybox.py [--vehicles 9] [--first 2601]

One WLTC drive of 700 s each; capacities 0.06 g, 0.25 g and the vehicle's own in turn. All numbers
are simulated.
"""

import argparse

import numpy as np

from monitor.base import config
from training.dyno import vehicle as vehicles
from training.greybox.catalyst.fit import Drive, fit
from training.studies.catalyst.cases import PERIOD_S, Case, drive

CAPACITIES_G = (0.06, 0.25, None)


def main() -> None:
    """Fit every vehicle; print one line each, and how often two errors reach the truth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicles", type=int, default=9)
    parser.add_argument("--first", type=int, default=2601)
    args = parser.parse_args()
    settings, ratios, offsets = config.shipped().catalyst, [], []
    for i in range(args.vehicles):
        vehicle = args.first + i
        case = Case("greybox", CAPACITIES_G[i % len(CAPACITIES_G)])
        names, values, true_g = drive(vehicle, "wltc_3b", case, 700.0)
        column = {name: np.nan_to_num(values[:, k], nan=1.0) for k, name in enumerate(names)}
        air_g_s = column["maf_kg_h"] / 3.6
        counts = np.isfinite(values).all(axis=1) & (air_g_s <= settings.flow_most_g_s)
        counts &= column["catalyst_temperature_degc"] >= settings.warm_degc
        x = 1.0 - 1.0 / np.maximum(column["lambda_measured"], 0.1)
        volts = column["downstream_voltage_v"]
        fitted = fit([Drive(str(vehicle), PERIOD_S, x, air_g_s, volts, counts)])
        found, error = fitted.constants, fitted.errors
        true_offset = vehicles.piece(vehicle).sensor_offset
        ratios.append(found.capacity_g / true_g)
        offsets.append(found.offset_phi - true_offset)
        print(
            f"{vehicle}: capacity {found.capacity_g:.3f} ± {error.capacity_g:.3f} g "
            f"of {true_g:.3f}, "
            f"offset {found.offset_phi:+.4f} ± {error.offset_phi:.4f} of {true_offset:+.4f}, "
            f"fill {found.fill:.1f} ± {error.fill:.1f}, release {found.release:.1f} ± "
            f"{error.release:.1f}, voltage within {fitted.rmse_v:.3f} V, "
            f"starts {fitted.spread:.2f}",
            flush=True,
        )
    print(
        f"capacity: bias {100 * np.expm1(np.log(ratios).mean()):+.0f} %, "
        f"spread {100 * np.log(ratios).std():.0f} %; "
        f"offset: bias {np.mean(offsets):+.4f}, spread {np.std(offsets):.4f}"
    )


if __name__ == "__main__":
    main()
