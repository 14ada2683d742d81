"""Subcommand ``o2train fleet``: a fleet's recordings judged, one row for each."""

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

A manifest is a .csv with the columns path and vehicle; the drives of a vehicle, in their order,
share its fault memory and its reference, as with o2mon replay --memory. Writes results.parquet
(a row for each recording), results.windows.parquet (a row for each window), results.html and
results.json. A run that was killed goes on where it was when the same command is given again.
Without manifest and --vehicle every recording is judged by itself."""


def add_parsers(subparsers: "argparse._SubParsersAction[Any]") -> None:
    """Add the subcommand ``fleet``; it sets ``func``."""
    fleet = subparsers.add_parser(
        "fleet",
        help="judge all recordings of a fleet, here or on a Dask cluster",
        description="Every recording judged: a table with a row for each, one with a row for each "
        "window, and a report over the fleet.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    fleet.add_argument(
        "recordings",
        nargs="+",
        metavar="DIR|GLOB|MANIFEST",
        help="folders (with those below), patterns, manifests, single recordings; paths or URLs "
        "that fsspec knows",
    )
    fleet.add_argument(
        "--model", type=Path, required=True, metavar="FILE", help="model with its limits, .onnx"
    )
    fleet.add_argument(
        "--out", type=Path, required=True, metavar="FILE", help="table to write, .parquet"
    )
    fleet.add_argument(
        "--vehicle",
        metavar="REGEX",
        help="expression whose first group names the vehicle in a path, unless a manifest does",
    )
    fleet.add_argument(
        "--false-alarms",
        type=float,
        default=0.001,
        metavar="RATE",
        help="wished rate per window, or drive, for which limits are proposed (default 0.001)",
    )
    add_cores_options(fleet)
    fleet.add_argument("--config", type=Path, help="TOML that changes shipped settings")
    add_bus_options(fleet)
    fleet.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Judge the fleet and write tables and report; returns 0, or 3 if nothing could be judged.

    Raises UsageError, ModelError, ConfigError or SignalMapError, which end with exit code 2.
    """
    from tqdm import tqdm

    from monitor.base import config
    from monitor.base.errors import UsageError
    from training.fleet import fleet_page
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
    html, tree = fleet_page.write(args.out, bench, found, args.false_alarms)
    fleet.finish(args.out)
    print(
        f"{found['drives']} recordings, {found['driving_s'] / 3600.0:.1f} h: {found['faults']} "
        f"with a code, {found['errors']} could not be judged"
    )
    print(f"recordings: {args.out}\nwindows: {fleet.windows_path(args.out)}")
    print(f"figures: {tree}\nreport: {html}")
    return 0 if found["errors"] < found["drives"] else 3
