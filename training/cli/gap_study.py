"""Subcommand ``o2train gap-study``: the gap workflow on many simulated cases, with a report."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from monitor.base.errors import UsageError
from training.cli.cores import add_cores_options, jobs_of

if TYPE_CHECKING:
    from training.studies.gap.plan import Study

REPORT, RESULT = "report.html", "gap_study.json"


def add_parsers(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the subcommand ``gap-study``."""
    study = commands.add_parser(
        "gap-study",
        help="hide effects and faults in simulated vehicles and count the right answers",
    )
    study.add_argument(
        "--base",
        default="greybox",
        metavar="NAME",
        help="model to start from: greybox (default) or narx, fitted to healthy recordings",
    )
    study.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder for the cases and report.html; a stopped run continues there",
    )
    study.add_argument(
        "--kinds",
        metavar="NAME,…",
        help="kinds of cases: effect, null, unknown, two, onset, fault (default: all)",
    )
    study.add_argument(
        "--cases",
        nargs="+",
        default=[],
        metavar="[KIND=]N",
        help="number of cases of every kind, or of KIND",
    )
    study.add_argument(
        "--vehicles", type=int, default=20, metavar="N", help="number of vehicles (default: 20)"
    )
    study.add_argument(
        "--first-vehicle",
        type=int,
        default=2100,
        metavar="N",
        help="number of the first vehicle (default: 2100)",
    )
    study.add_argument(
        "--seed",
        type=int,
        default=2_000_000,
        metavar="N",
        help="seed of the first drive; later drives count up (default: 2000000)",
    )
    study.add_argument(
        "--drives", type=int, default=6, metavar="N", help="recordings per case (default: 6)"
    )
    study.add_argument(
        "--minutes", type=float, default=10.0, help="minutes per recording (default: 10)"
    )
    study.add_argument(
        "--fitted-with-effect",
        action="store_true",
        help="fit the base to the case's recordings that are not held out; a network may then "
        "be retrained",
    )
    study.add_argument(
        "--sensor-known-good",
        action="store_true",
        help="pass this option to the workflow and leave out the kinds onset and fault",
    )
    add_cores_options(study)
    study.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Run the cases and write the report, also if interrupted; return 0."""
    from tqdm import tqdm

    from training.jobs import run_folder
    from training.studies.gap import report
    from training.studies.gap import run as study_run

    study, jobs = _study(args), jobs_of(args)
    identity = study_run.begin(study, args.out)
    try:
        with tqdm(total=report.planned(study), unit="case", disable=None) as bar:
            study_run.run(study, args.out, bar.update, jobs=jobs, scheduler=args.scheduler)
    finally:
        rows = study_run.rows(study, args.out)
        print(report.as_text(rows, study))
        (args.out / REPORT).write_text(report.as_page(rows, study, identity))
        run_folder.write_json(args.out / RESULT, report.result(rows, study, identity), indent=1)
        print(f"report: {args.out / REPORT}")
    return 0


def _study(args: argparse.Namespace) -> "Study":
    from training.studies.gap.plan import BASES, CASES, FAULTY, KINDS, Study

    if args.base not in BASES:
        raise UsageError(f"base {args.base!r} is unknown; there are {', '.join(BASES)}")
    left_out = FAULTY if args.sensor_known_good else ()
    kinds = args.kinds.split(",") if args.kinds else [k for k in KINDS if k not in left_out]
    numbers = {kind: CASES[args.base].get(kind, 0) for kind in kinds}
    for text in args.cases:
        kind, _, number = text.rpartition("=")
        try:
            chosen = {kind: int(number)} if kind else dict.fromkeys(kinds, int(number))
        except ValueError:
            raise UsageError(f"--cases {text!r}: wanted N or KIND=N") from None
        if not set(chosen) <= set(kinds):
            raise UsageError(f"--cases {text!r}: --kinds has {', '.join(kinds)}")
        numbers |= chosen
    return Study(
        base=args.base,
        cases=tuple(numbers.items()),
        vehicles=args.vehicles,
        first_vehicle=args.first_vehicle,
        seed=args.seed,
        drives=args.drives,
        duration_s=60.0 * args.minutes,
        fitted_with_effect=args.fitted_with_effect,
        sensor_known_good=args.sensor_known_good,
    )
