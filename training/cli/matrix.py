"""The command ``o2train evaluate --matrix``: judge many simulated drives and report the rates."""

import argparse
from typing import TYPE_CHECKING

from monitor.base import config
from monitor.base import option_paths as paths
from monitor.base.errors import UsageError
from monitor.base.outputs import write_text
from training.cli import catalyst_matrix
from training.cli.cores import add_cores_options, jobs_of

if TYPE_CHECKING:
    from monitor.base.config import Config
    from training.limits.rates import Figures
    from training.studies.matrix.plan import Matrix

REPORT, RESULT = "report.html", "matrix.json"
PARTS = ("sensor", "catalyst")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the matrix to the command ``evaluate``."""
    group = parser.add_argument_group(
        "matrix",
        "The monitor judges simulated drives: vehicles × cycles × ambient conditions × faults ×\n"
        "severities × placements × repetitions. Repeat the same command to continue a stopped run.",
    )
    group.add_argument(
        "--matrix", action="store_true", help="simulate and judge the matrix; takes no RECORDING"
    )
    group.add_argument(
        "--out",
        type=paths.folder,
        metavar="DIR",
        help="folder for the rows, report.html and matrix.json (required)",
    )
    group.add_argument(
        "--parts",
        nargs="+",
        choices=PARTS,
        default=list(PARTS),
        help="parts of the matrix: sensor, catalyst (default: both; of both, matrix.json holds "
        "the second one under the key catalyst)",
    )
    _add_vehicles(group)
    _add_conditions(group)
    catalyst_matrix.add_options(group)
    add_cores_options(group)
    group.add_argument("--config", type=paths.read, help="TOML file that changes shipped settings")


def _add_vehicles(parser: argparse._ArgumentGroup) -> None:
    """Add the simulated vehicles and the numbers of their drives."""
    parser.add_argument(
        "--vehicles",
        type=int,
        default=60,
        metavar="N",
        help="number of simulated vehicles (default 60)",
    )
    parser.add_argument(
        "--first-vehicle",
        type=int,
        default=5000,
        metavar="N",
        help="number of the first simulated vehicle (default 5000)",
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=5_000_000,
        metavar="N",
        help="seed of the first drive; every further drive takes the next seed (default 5000000)",
    )
    parser.add_argument(
        "--repetitions",
        type=int,
        default=100,
        metavar="N",
        help="drives per fault and placement at the limit severity (default 100); other "
        "severities get a quarter",
    )
    parser.add_argument(
        "--healthy",
        type=int,
        default=600,
        metavar="N",
        help="number of healthy drives (default 600)",
    )
    parser.add_argument(
        "--reference-drives",
        type=int,
        default=40,
        metavar="N",
        help="healthy drives per vehicle that teach its reference before its other drives "
        "(default 40)",
    )


def _add_conditions(parser: argparse._ArgumentGroup) -> None:
    """Add cycles, faults and ambient conditions."""
    parser.add_argument(
        "--cycles",
        nargs="+",
        default=[],
        metavar="CYCLE",
        help="cycles to drive: wltc_3b, udds, us06, hwfet, micro_trips, steady (default: wltc_3b "
        "with a fault, a mixture of cycles when healthy)",
    )
    parser.add_argument(
        "--faults",
        nargs="+",
        metavar="NAME[=SEVERITY,…]",
        help="sensor faults, for example slow_symmetric=0.3,0.5 (default: all faults at severities "
        "below, at and above the limit)",
    )
    parser.add_argument(
        "--ambient",
        nargs="+",
        metavar="NAME",
        help="ambient conditions: mild, hot, cold, altitude (default: all)",
    )


def run(args: argparse.Namespace) -> int:
    """Simulate and judge the parts of the matrix, write their pages and return exit code 0.

    Raises UsageError for an impossible option (exit code 2).
    """
    import json

    if args.recordings:
        raise UsageError("--matrix drives the simulated vehicle, no RECORDING is wanted")
    if args.out is None:
        raise UsageError("--matrix needs --out DIR")
    settings = config.load(args.config)
    result = _sensor(args, settings) if "sensor" in args.parts else {}
    if "catalyst" in args.parts:
        behind = catalyst_matrix.run(args, settings)
        result = result | {"catalyst": behind} if result else behind
    text = json.dumps(result, indent=1, allow_nan=False) + "\n"
    for path in (args.out / RESULT, args.json):
        if path is not None:
            write_text(path, text)
    return 0


def _sensor(args: argparse.Namespace, settings: "Config") -> "Figures":
    """Simulate and judge the drives of the upstream sensor, write their page; return the result."""
    from tqdm import tqdm

    from training.jobs import run_folder
    from training.studies.matrix import matrix_result
    from training.studies.matrix import run as matrix_run
    from training.studies.matrix.matrix_page import as_page

    matrix = _matrix(args)
    cores = matrix_run.Cores(jobs_of(args), args.scheduler)
    with tqdm(total=matrix_run.count(matrix), unit="drive", disable=args.nothing or None) as bar:
        rows = matrix_run.run(
            matrix, args.model, config=settings, folder=args.out, done=bar.update, cores=cores
        )
    result = matrix_result.result(rows, run_folder.identity_of(args.out), args.model.name)
    print(matrix_result.as_text(result))
    write_text(args.out / REPORT, as_page(result, rows))
    print(f"report: {args.out / REPORT}")
    return result


def _matrix(args: argparse.Namespace) -> "Matrix":
    from training.studies.matrix.conditions import AMBIENTS
    from training.studies.matrix.plan import Matrix
    from training.studies.matrix.severities import SEVERITIES

    chosen = SEVERITIES if args.faults is None else dict(map(_fault, args.faults))
    return Matrix(
        vehicles=args.vehicles,
        first_vehicle=args.first_vehicle,
        seed=args.seed,
        repetitions=args.repetitions,
        healthy=args.healthy,
        reference_drives=args.reference_drives,
        cycles=tuple(args.cycles),
        ambients=tuple(args.ambient or AMBIENTS),
        faults=tuple(chosen.items()),
    )


def _fault(text: str) -> tuple[str, tuple[float, ...]]:
    from training.studies.matrix.severities import SEVERITIES

    name, _, values = text.partition("=")
    if name not in SEVERITIES:
        raise UsageError(f"fault {name!r} is unknown; there are {', '.join(SEVERITIES)}")
    if not values:
        return name, SEVERITIES[name]
    try:
        return name, tuple(float(value) for value in values.split(","))
    except ValueError:
        raise UsageError(f"{text!r}: wanted NAME=SEVERITY,…") from None
