"""A network of the downstream voltage, with and without the catalyst's store as an input.

    python benchmarks/catalyst_network.py [--budget 3] [--seconds 900]

One simulated vehicle, three drives to train, two to test, free run. Inputs: 1 - 1/lambda upstream,
air flow, brick temperature, fuel cut. The second network also has the oxygen held by a store of the
capacity that ``o2train fit --kind greybox --output downstream_voltage_v`` finds on the first drive.
"""

import argparse
import json
import tempfile
from pathlib import Path
from typing import Final

import numpy as np

from training.cli import main as o2train
from training.recordings.oxygen_store import held_g
from training.studies.catalyst.cases import CYCLES, PERIOD_S, Case, drive

VEHICLE: Final = 451
BASE: Final = ("x_upstream", "maf_kg_h", "catalyst_temperature_degc", "fuel_cut")
STORE: Final = "oxygen_store_g"


def write(folder: Path, cycle: str, seconds: float, capacity_g: float | None) -> Path:
    """Write one drive as a table, with the store if its capacity is known; return its path."""
    names, values, _ = drive(VEHICLE, cycle, Case("network"), seconds)
    column = dict(zip(names, values.T, strict=True))
    good = np.isfinite(values[:, [names.index(n) for n in ("lambda_measured", "maf_kg_h")]])
    first = int(np.argmax(good.all(axis=1)))
    column = {name: each[first:] for name, each in column.items()}
    lambda_, maf = column["lambda_measured"], column["maf_kg_h"]
    kept = {name: column[name] for name in BASE[1:]}
    kept["lambda_measured"] = lambda_
    kept["x_upstream"] = 1.0 - 1.0 / np.maximum(lambda_, 0.1)
    kept["downstream_voltage_v"] = column["downstream_voltage_v"]
    if capacity_g is not None:
        kept[STORE] = held_g(lambda_, maf / 3.6, PERIOD_S, capacity_g)
    path = folder / f"{cycle}{'_store' if capacity_g else ''}.csv"
    table = np.column_stack([np.arange(len(lambda_)) * PERIOD_S, *kept.values()])
    header = ",".join(["time_s", *kept])
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.6g")
    return path


def main() -> None:
    """Fit both networks and print their errors on the test drives."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--budget", type=float, default=3.0, help="minutes for each network")
    parser.add_argument("--seconds", type=float, default=900.0)
    args = parser.parse_args()
    folder = Path(tempfile.mkdtemp())
    grey = ["--kind", "greybox", "--output", "downstream_voltage_v", "--out"]
    first = write(folder, CYCLES[0], args.seconds, None)
    o2train(["fit", str(first), *grey, str(folder / "catalyst.json")])
    tree = json.loads((folder / "catalyst.json").read_text())
    capacity_g = tree["constants"]["capacity_g"]["value"]
    for inputs, grams in ((BASE, None), ((*BASE, STORE), capacity_g)):
        train = [str(write(folder, c, args.seconds, grams)) for c in CYCLES]
        test = [str(write(folder, c, args.seconds, grams)) for c in ("us06", "hwfet")]
        model, out = folder / f"{len(inputs)}.onnx", folder / f"{len(inputs)}.json"
        shape = ["--lags", "5", "--hidden", "8", "--starts", "2", "--budget", str(args.budget)]
        named = ["--inputs", *inputs, "--output", "downstream_voltage_v"]
        o2train(["fit", *train, *named, *shape, "--out", str(model)])
        o2train(["evaluate", "--model", str(model), *test, "--json", str(out)])
        for row in json.loads(out.read_text())["recordings"]:
            print(
                f"inputs {len(inputs)}, {Path(row['path']).stem}: free run {row['rmse']:.3f} V, "
                f"fit {row['fit_percent']:.0f} %, correlation {row['correlation']:.2f}, "
                f"one step {row['one_step_rmse']:.3f} V"
            )


if __name__ == "__main__":
    main()
