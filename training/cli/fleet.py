"""Subcommand ``o2train fleet``: judge the recordings of a fleet."""

import argparse
from pathlib import Path
from typing import Any

from training.cli.cores import add_cores_options, jobs_of
from training.cli.recordings import add_bus_options, pairs_of

_EXAMPLES = """examples:
  o2train fleet logs/ --model model.onnx --out results.parquet
  o2train fleet 's3://fleet/2026/*.mf4' --model model.onnx --out results.parquet \\
      --scheduler tcp://scheduler:8786
  o2train fleet manifest.csv --model model.onnx --out results.parquet

A manifest is a .csv with the columns path and vehicle. The drives of a vehicle share its fault
memory and reference, in the manifest's order, as with o2mon replay --memory. Without a manifest or
--vehicle every recording is judged alone.

Output: results.parquet (one row per recording), results.windows.parquet (one row per window),
results.html and results.json. To continue a stopped run, give the same command again."""


def add_parsers(subparsers: "argparse._SubParsersAction[Any]") -> None:
    """Add the subcommand ``fleet``."""
    fleet = subparsers.add_parser(
        "fleet",
        help="judge the recordings of a fleet, here or on a Dask cluster",
        description="Judge every recording of a fleet. Write a table with one row per recording, a "
        "table with one row per window, and a report.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    fleet.add_argument(
        "recordings",
        nargs="+",
        metavar="DIR|GLOB|MANIFEST",
        help="folders (with their subfolders), patterns, manifests or recordings, as paths or "
        "fsspec URLs",
    )
    fleet.add_argument(
        "--model", type=Path, required=True, metavar="FILE", help="model with its limits, .onnx"
    )
    fleet.add_argument(
        "--out", type=Path, required=True, metavar="FILE", help="table of recordings, .parquet"
    )
    fleet.add_argument(
        "--vehicle",
        metavar="REGEX",
        help="regular expression; its first group is the vehicle's name in a path "
        "(default: the manifest names it)",
    )
    fleet.add_argument(
        "--false-alarms",
        type=float,
        default=0.001,
        metavar="RATE",
        help="false-alarm rate per window, or per drive, for which limits are proposed "
        "(default: 0.001)",
    )
    add_cores_options(fleet)
    fleet.add_argument("--config", type=Path, help="TOML file that changes the shipped settings")
    add_bus_options(fleet)
    fleet.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Judge the fleet and write tables and report; return 0, or 3 if no recording was judged.

    Raises UsageError, ModelError, ConfigError or SignalMapError (exit code 2).
    """
    from tqdm import tqdm

    from monitor.base import config
    from monitor.base.errors import UsageError
    from training.fleet import report
    from training.fleet import run as fleet
    from training.fleet.bench import Bench
    from training.fleet.drives import drives_of

    if not 0.0 < args.false_alarms < 1.0:
        raise UsageError("--false-alarms is above 0 and below 1")
    jobs = jobs_of(args)
    bench = Bench.of(args.model, config.load(args.config), pairs_of(args), args.columns)
    drives = drives_of(args.recordings, args.vehicle, fleet.written_paths(args.out))
    errors = faults = 0
    with tqdm(total=len(drives), unit="drive", disable=None) as bar:

        def done(chunk: dict[str, Any]) -> None:
            nonlocal errors, faults
            errors, faults = errors + chunk["errors"], faults + chunk["faults"]
            bar.set_postfix_str(f"{faults} with a code, {errors} not judged", refresh=False)
            bar.update(chunk["drives"])

        found = fleet.run(drives, bench, args.out, done, jobs=jobs, scheduler=args.scheduler)
    html, tree = report.write(args.out, bench, found, args.false_alarms)
    fleet.finish(args.out)
    print(
        f"{found['drives']} recordings, {found['driving_s'] / 3600.0:.1f} h: {found['faults']} "
        f"with a code, {found['errors']} could not be judged"
    )
    print(f"recordings: {args.out}\nwindows: {fleet.windows_path(args.out)}")
    print(f"figures: {tree}\nreport: {html}")
    return 0 if found["errors"] < found["drives"] else 3
