"""Results of ``o2train gap`` on real recordings, for which the truth is unknown.

- a gasoline engine on a test bench (boschresearch/Bosch-Engine-Datasets, CC BY-SA 4.0): a network
  fitted to ten runs, tested on the other two; the scale of lambda as in ``bosch.py``;
- a Mazda MX-5 on the road (karniv00l/mlg-converter, MIT): a network and a grey-box chain fitted to
  three of the logger's runs, tested on two others. Fuel is the pulse width less 1 ms; air is the
  ECU's volumetric efficiency of 0.4 l per cylinder; both scales are assumptions;
- pulls of a turbo car (KalebKE/ME7Tuner, Apache-2.0): one recording without fuel and air, cut in
  two.

Without fuel and air per stroke no effect can be tried. No result can be checked.

    python benchmarks/gap_real.py [FOLDER] [--budget MINUTES]
"""

import argparse
import tempfile
from pathlib import Path
from typing import Final

import polars as pl

from training.cli import main as o2train

BOSCH: Final = """
time_s = "time_s"
speed_z = "speed_z"
load_z = "load_z"
ignition_angle_z = "ignition_angle_z"
fuel_cutoff_z = "fuel_cutoff_z"
lambda_measured = { column = "lambda_z", factor = 0.064, offset = 1.00416 }
"""
BOSCH_INPUTS: Final = ("speed_z", "load_z", "ignition_angle_z", "fuel_cutoff_z")
BOSCH_FITTED: Final = (10, 11, 12, 13, 14, 15, 30, 31, 32, 33)
BOSCH_NEW: Final = (53, 54)
MX5_FITTED, MX5_NEW = (0, 4, 6), (7, 15)  # runs of the logger
MX5_INPUTS: Final = (
    "engine_speed_rpm",
    "manifold_pressure_kpa",
    "pulse_width_ms",
    "lambda_controller",
)
MX5_CHAIN: Final = ("fuel_mass_mg", "air_mass_mg", "engine_speed_rpm", "lambda_controller")
NOT_READY_AFR, DEAD_MS, NEAR_ONE = 7.4, 1.0, 0.1
CYLINDER_L, GAS_J_KG_K, STOICHIOMETRIC = 0.4, 287.0, 14.7
ME7_INPUTS: Final = ("engine_speed_rpm", "boost_raw", "tps_pct")
PERIOD_S: Final = "0.1"


def mx5(folder: Path, into: Path) -> dict[int, str]:
    """Write each of the logger's runs as a table in canonical names; returns their paths."""
    read = pl.read_csv(folder / "vehicles" / "mx5_speeduino.csv.gz")
    kelvin = pl.col("iat_c") + 273.15
    air = pl.col("ve_pct") / 100 * pl.col("map_kpa") * 1e6 * CYLINDER_L / (GAS_J_KG_K * kelvin)
    open_ms = (pl.col("pw_ms") - DEAD_MS).clip(0.0)
    ready = pl.col("afr") > NOT_READY_AFR
    table = read.with_columns(
        lambda_measured=pl.when(ready).then(pl.col("lambda")),
        lambda_controller=pl.col("ego_corr_pct") / 100,
        engine_speed_rpm=pl.col("rpm"),
        manifold_pressure_kpa=pl.col("map_kpa"),
        manifold_temperature_degc=pl.col("iat_c"),
        coolant_temperature_degc=pl.col("clt_c"),
        pulse_width_ms=pl.col("pw_ms"),
        air_mass_mg=air,
        open_ms=open_ms,
    )
    near_one = (pl.col("lambda") - 1.0).abs() < NEAR_ONE
    at_one = table.filter(ready & (pl.col("open_ms") > 0) & near_one)
    mg_per_ms = at_one.select((pl.col("air_mass_mg") / STOICHIOMETRIC / pl.col("open_ms")).median())
    table = table.with_columns(fuel_mass_mg=pl.col("open_ms") * mg_per_ms.item())
    kept = ["time_s", "lambda_measured", "coolant_temperature_degc", "manifold_temperature_degc"]
    kept += list(dict.fromkeys((*MX5_INPUTS, *MX5_CHAIN)))
    paths = {}
    for run in (*MX5_FITTED, *MX5_NEW):
        paths[run] = str(into / f"mx5_{run}.csv")
        table.filter(pl.col("segment") == run).select(kept).write_csv(paths[run])
    return paths


def me7(folder: Path, into: Path) -> list[str]:
    """Write the halves of the recording as two tables; returns their paths."""
    table = pl.read_csv(folder / "vehicles" / "me7_zeitronix.csv.gz")
    table = table.with_columns(lambda_measured="lambda", engine_speed_rpm="rpm")
    half, paths = len(table) // 2, [str(into / f"me7_{half}.csv") for half in (1, 2)]
    table[:half].write_csv(paths[0])
    table[half:].write_csv(paths[1])
    return paths


def look(
    title: str, fitted: list[str], new: list[str], out: Path, fit: list[str], read: list[str]
) -> None:
    """Fit a model, and hold the new recordings against it and what it was fitted to."""
    print(f"\n# {title}", flush=True)
    model = str(out / "model.onnx")
    out.mkdir()
    if o2train(["fit", *fitted, "--out", model, *fit, *read]) == 0:
        found = str(out / "gap")
        o2train(["gap", "--model", model, *new, "--healthy", *fitted, "--out", found, *read])


def run(folder: Path, out: Path, budget: str) -> None:
    """Print what is found on each engine."""
    network = ["--budget", budget, "--seed", "1", "--inputs"]
    columns = out / "bosch.toml"
    columns.write_text(BOSCH)
    paths = {
        n: str(folder / "bosch_gengine1" / f"run_{n:06d}.csv.gz")
        for n in (*BOSCH_FITTED, *BOSCH_NEW)
    }
    look(
        "Engine on a test bench, network",
        [paths[n] for n in BOSCH_FITTED],
        new=[paths[n] for n in BOSCH_NEW],
        out=out / "bosch",
        fit=[*network, *BOSCH_INPUTS],
        read=["--columns", str(columns)],
    )
    runs = mx5(folder, out)
    on_grid = ["--period", PERIOD_S]
    chain = ["--kind", "greybox", "--inputs", *MX5_CHAIN]
    for kind, fit in (("network", [*network, *MX5_INPUTS]), ("chain", chain)):
        look(
            f"MX-5, {kind}",
            [runs[n] for n in MX5_FITTED],
            new=[runs[n] for n in MX5_NEW],
            out=out / f"mx5_{kind}",
            fit=fit,
            read=on_grid,
        )
    first, second = me7(folder, out)
    look(
        "Turbo car, network",
        [first],
        new=[second],
        out=out / "me7",
        fit=[*network, *ME7_INPUTS],
        read=on_grid,
    )


def main() -> None:
    """Look at the recordings in the folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=Path("../shared/data"))
    parser.add_argument("--budget", default="4", metavar="MINUTES")
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep models and reports in it")
    args = parser.parse_args()
    if args.out:
        args.out.mkdir(parents=True, exist_ok=True)
        run(args.folder, args.out, args.budget)
        return
    with tempfile.TemporaryDirectory() as name:
        run(args.folder, Path(name), args.budget)


if __name__ == "__main__":
    main()
