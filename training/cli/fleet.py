"""The command ``o2train fleet``: judge all recordings of a fleet, one table row per recording."""

import argparse
from pathlib import Path
from typing import Any

from monitor.base.command_line import option_paths as paths
from training.cli.cores import add_cores_options, jobs_of
from training.cli.recordings import add_bus_options, pairs_of

_EXAMPLES = """examples:
  o2train fleet logs/ --model model.onnx --out results.parquet
  o2train fleet 's3://fleet/2026/*.mf4' --model model.onnx --out results.parquet \\
      --scheduler tcp://scheduler:8786
  o2train fleet manifest.csv --model model.onnx --out results.parquet

A manifest is a CSV file with the columns path and vehicle. The drives of one vehicle, in the order
of the manifest, share its fault memory and its reference, as with o2mon replay --memory. Without a
manifest and without --vehicle, every recording is judged alone.

The command writes results.parquet (one row per recording), results.windows.parquet (one row per
window), results.html and results.json, and the pages of the first drives with a code in the folder
results.drives. Repeat the same command to continue a killed run.
Exit code 3: no recording could be judged."""


def add_parsers(subparsers: "argparse._SubParsersAction[Any]") -> None:
    """Add the command ``fleet`` to ``subparsers``."""
    fleet = subparsers.add_parser(
        "fleet",
        help="judge all recordings of a fleet, here or on a Dask cluster",
        description="Judge every recording of a fleet. The command writes a table with one row\n"
        "per recording, a table with one row per window, and a report on the fleet.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    fleet.add_argument(
        "recordings",
        nargs="+",
        type=paths.pattern,
        metavar="DIR|GLOB|MANIFEST",
        help="recordings, folders (searched with all their subfolders), patterns or manifests; "
        "paths, or URLs that fsspec can read",
    )
    fleet.add_argument(
        "--model",
        type=paths.read,
        required=True,
        metavar="FILE",
        help="model file with limits, .onnx",
    )
    fleet.add_argument(
        "--out",
        type=paths.written,
        required=True,
        metavar="FILE",
        help="table of recordings to write, .parquet",
    )
    fleet.add_argument(
        "--partitioned",
        type=paths.folder,
        metavar="DIR",
        help="write both tables also as folders per vehicle and date, for DuckDB, Spark and others",
    )
    fleet.add_argument(
        "--vehicle",
        metavar="REGEX",
        help=r"regular expression whose first group is the vehicle in a path, for example "
        r"'car_(\d+)'; a vehicle in the manifest wins",
    )
    fleet.add_argument(
        "--false-alarms",
        type=float,
        default=0.001,
        metavar="RATE",
        help="false-alarm rate, per window or per drive, for the limits that the report proposes "
        "(default 0.001)",
    )
    fleet.add_argument(
        "--reports",
        type=int,
        default=10,
        metavar="N",
        help="drives with a code whose own page is written beside, for the fleet's page to link "
        "(default 10)",
    )
    add_cores_options(fleet)
    fleet.add_argument("--config", type=paths.read, help="TOML file that changes shipped settings")
    add_bus_options(fleet)
    fleet.set_defaults(func=run, also_written=_also_written)


def _also_written(args: argparse.Namespace) -> list[Path]:
    """Return the files beside ``--out`` that a run writes."""
    windows = args.out.with_name(f"{args.out.stem}.windows{args.out.suffix}")
    return [windows, args.out.with_suffix(".html"), args.out.with_suffix(".json")]


def run(args: argparse.Namespace) -> int:
    """Judge the fleet, write tables and report, and return the exit code.

    Exit code 0 is a judged fleet; 3 means that no recording could be judged.
    Raises UsageError, ModelError, ConfigError or SignalMapError (exit code 2).
    """
    from tqdm import tqdm

    from monitor.base import config
    from monitor.base.errors import UsageError
    from training.cli import drive_reports
    from training.fleet import partitions
    from training.fleet import run as fleet
    from training.fleet.bench import Bench
    from training.fleet.drives import drives_of

    if not 0.0 < args.false_alarms < 1.0:
        raise UsageError("--false-alarms is above 0 and below 1")
    if args.reports < 0:
        raise UsageError(f"--reports {args.reports}: must not be negative")
    written = fleet.written_paths(args.out)
    if args.partitioned:
        partitions.check(args.partitioned)
        written = (*written, args.partitioned)
    jobs = jobs_of(args)
    bench = Bench.of(args.model, config.load(args.config), pairs_of(args), args.columns)
    drives = drives_of(args.recordings, args.vehicle, written)
    errors = faults = 0
    with tqdm(total=len(drives), unit="drive", disable=args.nothing or None) as bar:

        def done(chunk: dict[str, Any]) -> None:
            nonlocal errors, faults
            errors, faults = errors + chunk["errors"], faults + chunk["faults"]
            bar.set_postfix_str(f"{faults} with a code, {errors} not judged", refresh=False)
            bar.update(chunk["drives"])

        result = fleet.run(drives, bench, args.out, done, jobs=jobs, scheduler=args.scheduler)
    from training.fleet.page import fleet_page  # its pictures take a second to import

    html, json_path = fleet_page.write(
        args.out, bench, result, args.false_alarms, lambda drives: drive_reports.write(args, drives)
    )
    if args.partitioned:
        partitions.write(args.out, fleet.windows_path(args.out), args.partitioned)
    fleet.finish(args.out)
    print(
        f"{result['drives']} recordings, {result['driving_s'] / 3600.0:.1f} h: {result['faults']} "
        f"with a code, {result['errors']} could not be judged"
    )
    print(f"recordings: {args.out}\nwindows: {fleet.windows_path(args.out)}")
    if args.partitioned:
        print(f"by vehicle and date: {args.partitioned}")
    print(f"figures: {json_path}\nreport: {html}")
    return 0 if result["errors"] < result["drives"] else 3
