"""The command ``o2train fleet``: judge all recordings of a fleet, one table row per recording."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from monitor.base.command_line import option_paths as paths
from monitor.base.command_line.parameters import SettingsFile, reading_words
from monitor.base.counts import counted
from training.cli.options import CoreOptions, ReadOptions

EXAMPLES = """examples:
  o2train fleet logs/ --model model.onnx --out results.parquet
  o2train fleet 's3://fleet/2026/*.mf4' --model model.onnx --out results.parquet \\
      --scheduler tcp://scheduler:8786
  o2train fleet manifest.csv --model model.onnx --out results.parquet

A manifest is a CSV file with the columns path and vehicle. The drives of one vehicle, in the order
of the manifest, share its fault memory and its reference, as with o2mon replay --memory. Without a
manifest and without --vehicle, every recording is judged alone.

The command writes results.parquet (one row per recording), results.windows.parquet (one row per
window), results.html and results.json. Repeat the same command to continue a killed run.
Exit code 3: no recording could be judged."""


@dataclass(frozen=True, kw_only=True)
class FleetCommand(ReadOptions, SettingsFile, CoreOptions):
    r"""Options of a fleet's run.

    recordings : recordings, folders (searched with all their subfolders), patterns or manifests;
        paths, or URLs that fsspec can read
    model : model file with limits, .onnx
    out : table of recordings to write, .parquet
    vehicle : regular expression whose first group is the vehicle in a path, for example
        'car_(\d+)'; a vehicle in the manifest wins
    """

    recordings: Annotated[Sequence[str], paths.pattern, "DIR|GLOB|MANIFEST"] = field(kw_only=False)
    model: Annotated[Path, paths.read, "FILE"]
    out: Annotated[Path, paths.written, "FILE"]
    vehicle: Annotated[str | None, "REGEX"] = None


def also_written(args: FleetCommand) -> list[Path]:
    """Return the files beside ``--out`` that a run writes."""
    windows = args.out.with_name(f"{args.out.stem}.windows{args.out.suffix}")
    return [windows, args.out.with_suffix(".html"), args.out.with_suffix(".json")]


def run(args: FleetCommand) -> int:
    """Judge every recording of a fleet.

    The command writes a table with one row per recording, a table with one row per window, and a
    report on the fleet.

    Raises UsageError, ModelError, ConfigError or SignalMapError (exit code 2). Exit code 0 is a
    judged fleet; 3 means that no recording could be judged.
    """
    from tqdm import tqdm

    from monitor.base import config
    from training.fleet import run as fleet
    from training.fleet.drives import drives_of
    from training.fleet.worker_kit import WorkerKit

    settings = config.load(args.config)
    kit = WorkerKit.of(args.model, settings, args.pairs or None, args.columns, args.channel)
    written = (args.out, fleet.windows_path(args.out), fleet.work_folder(args.out))
    drives = drives_of(args.recordings, args.vehicle, written)
    errors = faults = 0
    with tqdm(total=len(drives), unit="drive", disable=None) as bar:

        def done(chunk: dict[str, Any]) -> None:
            nonlocal errors, faults
            errors, faults = errors + chunk["errors"], faults + chunk["faults"]
            bar.set_postfix_str(f"{faults} with a code, {errors} not judged", refresh=False)
            bar.update(chunk["drives"])

        result = fleet.run(drives, kit, args.out, done, jobs=args.n_jobs, scheduler=args.scheduler)
    from training.fleet.page import fleet_page  # its pictures take a second to import

    html, json_path, found = fleet_page.write(args.out, kit, result, partial(_replay, args))
    fleet.finish(args.out)
    print(
        f"{counted(result['drives'], 'recording')}, {result['driving_s'] / 3600.0:.1f} h: "
        f"{result['faults']} with a code, {result['errors']} could not be judged; "
        f"the response test decided {found['completed']['events']}"
    )
    for each in found["not_judged"][:3]:
        which = f"{counted(each['recordings'], 'recording')}, {each['examples'][0]}"
        print(f"not judged: {which}: {each['reason']}")
    print(f"recordings: {args.out}\nwindows: {fleet.windows_path(args.out)}")
    print(f"figures: {json_path}\nreport: {html}")
    return 0 if result["errors"] < result["drives"] else 3


def _replay(args: FleetCommand, path: str) -> str:
    """Return the command for the page of one drive."""
    from monitor.grid.tables import kinds_of

    kinds, settings = kinds_of(Path(path)), ["--config", args.config] if args.config else []
    reading = reading_words(kinds, args.pairs, args.columns, args.channel)
    words = [path, "--model", args.model, *reading, *settings, "--html", f"{Path(path).stem}.html"]
    return shlex.join(["o2mon", "replay", *map(str, words)])
