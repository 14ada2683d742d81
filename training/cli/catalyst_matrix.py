"""The part of ``o2train evaluate --matrix`` behind the catalyst."""

import argparse
from typing import TYPE_CHECKING, Final

from monitor.base.outputs import write_text
from training.cli.cores import jobs_of

if TYPE_CHECKING:
    from monitor.base.config import Config
    from training.limits.rates import Figures

FOLDER: Final = "catalyst"  # below --out, for the rows
PAGE: Final = "catalyst.html"


def add_options(parser: argparse._ArgumentGroup) -> None:
    """Add the options of the drives with a catalyst."""
    parser.add_argument(
        "--catalyst-drives",
        type=int,
        default=840,
        metavar="N",
        help="number of drives with a catalyst, a vehicle each (default 840); five of eight have "
        "a drawn catalyst and sensors, two wrong metering or fuel, one is of a second engine",
    )
    parser.add_argument(
        "--catalyst-first-vehicle",
        type=int,
        default=30_001,
        metavar="N",
        help="number of the first of these vehicles (default 30001)",
    )
    parser.add_argument(
        "--catalyst-seconds",
        type=float,
        default=600.0,
        metavar="S",
        help="length of each of these drives, at least 60 (default 600)",
    )


def run(args: argparse.Namespace, settings: "Config") -> "Figures":
    """Simulate and judge the drives with a catalyst, write their page and return the result.

    Raises UsageError for an impossible option (exit code 2).
    """
    from tqdm import tqdm

    from training.jobs import run_folder
    from training.studies.catalyst import catalyst_page, targets
    from training.studies.catalyst import run as catalyst_run
    from training.studies.catalyst.plan import CatalystMatrix
    from training.studies.matrix.run import Cores

    matrix = CatalystMatrix(
        args.catalyst_drives, args.catalyst_first_vehicle, args.catalyst_seconds
    )
    folder, cores = args.out / FOLDER, Cores(jobs_of(args), args.scheduler)
    with tqdm(total=matrix.drives, unit="drive", disable=args.nothing or None) as bar:
        rows, limits = catalyst_run.run(matrix, settings, folder, bar.update, cores)
    result = catalyst_page.result(rows, limits, run_folder.identity_of(folder))
    print(targets.as_text(result))
    write_text(args.out / PAGE, catalyst_page.as_page(result))
    print(f"report: {args.out / PAGE}")
    return result
