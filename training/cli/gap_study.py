"""The command ``o2train gap-study``: run the gap workflow on many simulated cases."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from monitor.base import option_paths as paths
from monitor.base.errors import UsageError
from monitor.base.outputs import write_text
from training.cli.cores import add_cores_options, jobs_of

if TYPE_CHECKING:
    from training.studies.gap.plan import Study

REPORT, RESULT = "report.html", "gap_study.json"
_EXAMPLES = """examples:
  o2train gap-study --out study
  o2train gap-study --out study --base narx --kinds effect,null --cases 40
  o2train gap-study --out study --cases effect=80 fault=20 --jobs 4
  o2train gap-study --export challenge --vehicles 4 --cases effect=20 null=10 fault=5
  o2train gap-study --score answers.json --export challenge

Repeat the same command to continue a stopped run."""


def add_parsers(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the command ``gap-study`` to ``commands``."""
    study = commands.add_parser(
        "gap-study",
        help="hide effects and faults in simulated vehicles and count the right answers",
        description="Hide effects and sensor faults in simulated vehicles, run the gap workflow\n"
        "on every case, and report how often it names the truth.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_cases(study)
    _add_drives(study)
    study.add_argument(
        "--fitted-with-effect",
        action="store_true",
        help="fit the model to the recordings of its case, except the held-out recordings; the "
        "workflow may then train a network again",
    )
    study.add_argument(
        "--export",
        type=paths.folder,
        metavar="DIR",
        help="write a challenge instead of running the study: recordings of every case and of its "
        "healthy vehicle, and the hash of the truth. The truth is written beside, as "
        "DIR-truth.json: keep it until the answers are in. Vehicles and seeds are drawn in secret",
    )
    study.add_argument(
        "--score",
        type=paths.read,
        metavar="ANSWERS",
        help="count the right answers of a challenge: answers.json of the folder, filled in by "
        "anyone. With --export DIR, the truth must have the hash in DIR",
    )
    study.add_argument(
        "--truth",
        type=paths.read,
        metavar="FILE",
        help="truth of the challenge (default: DIR-truth.json beside --export DIR)",
    )
    study.add_argument(
        "--sensor-known-good",
        action="store_true",
        help="pass --sensor-known-good to the workflow; leaves the kinds onset and fault out",
    )
    add_cores_options(study)
    study.set_defaults(func=run, also_written=_written)


def _written(args: argparse.Namespace) -> list[Path]:
    """Return the files that the command writes beside those of the options."""
    if args.score:
        return []
    if args.export:
        return [_truth(args)]
    return [args.out / REPORT, args.out / RESULT] if args.out else []


def _truth(args: argparse.Namespace) -> Path:
    if args.truth is not None:
        return Path(args.truth)
    if args.export is None:
        raise UsageError("--score needs --truth FILE or --export DIR")
    return Path(args.export).with_name(f"{Path(args.export).name}-truth.json")


def _add_cases(parser: argparse.ArgumentParser) -> None:
    """Add the model under study, the folder and the cases."""
    parser.add_argument(
        "--base",
        default="greybox",
        metavar="NAME",
        help="kind of the model under study, greybox or narx (default greybox); the study fits it "
        "to healthy recordings",
    )
    parser.add_argument(
        "--out",
        type=paths.folder,
        metavar="DIR",
        help="folder for the cases, report.html and gap_study.json; needed without --export and "
        "--score",
    )
    parser.add_argument(
        "--kinds",
        metavar="NAME,…",
        help="kinds of cases: effect, null, unknown, two, onset, fault (default: all)",
    )
    parser.add_argument(
        "--cases",
        nargs="+",
        default=[],
        metavar="[KIND=]N",
        help="number of cases of every kind (40) or of one kind (effect=80); default: 60 to 400 "
        "per kind",
    )


def _add_drives(parser: argparse.ArgumentParser) -> None:
    """Add the simulated vehicles and their drives."""
    parser.add_argument(
        "--vehicles",
        type=int,
        default=20,
        metavar="N",
        help="number of simulated vehicles (default 20)",
    )
    parser.add_argument(
        "--first-vehicle",
        type=int,
        default=2100,
        metavar="N",
        help="number of the first simulated vehicle (default 2100)",
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=2_000_000,
        metavar="N",
        help="seed of the first drive; every further drive takes the next seed (default 2000000)",
    )
    parser.add_argument(
        "--drives", type=int, default=6, metavar="N", help="recordings per case (default 6)"
    )
    parser.add_argument(
        "--minutes", type=float, default=10.0, help="length of a recording (default 10)"
    )


def run(args: argparse.Namespace) -> int:
    """Run the cases, write the report and return exit code 0.

    An interrupted run also writes a report, with the finished cases.
    Raises UsageError for an impossible option (exit code 2).
    """
    if args.score:
        return _score(args)
    if args.export:
        return _export(args)
    if args.out is None:
        raise UsageError("--out DIR is needed, or --export DIR, or --score ANSWERS")
    from tqdm import tqdm

    from training.jobs import run_folder
    from training.studies.gap import gap_study_result as result
    from training.studies.gap import run as study_run
    from training.studies.gap.gap_study_page import as_page

    study, jobs = _study(args), jobs_of(args)
    identity = study_run.begin(study, args.out)
    try:
        with tqdm(total=result.planned(study), unit="case", disable=args.nothing or None) as bar:
            study_run.run(study, args.out, bar.update, jobs=jobs, scheduler=args.scheduler)
    finally:
        rows = study_run.rows(study, args.out)
        print(result.as_text(rows, study))
        write_text(args.out / REPORT, as_page(rows, study, identity))
        run_folder.write_json(args.out / RESULT, result.result(rows, study, identity), indent=1)
        print(f"report: {args.out / REPORT}")
    return 0


def _export(args: argparse.Namespace) -> int:
    from tqdm import tqdm

    from training.studies.gap import challenge

    study = challenge.secret(_study(args))
    with tqdm(unit="folder", disable=args.nothing or None) as bar:
        digest = challenge.export(study, args.export, _truth(args), bar.update)
    print(f"challenge: {args.export}\ntruth: {_truth(args)}, sha256 {digest}")
    return 0


def _score(args: argparse.Namespace) -> int:
    from training.studies.gap import challenge

    print(challenge.as_text(challenge.score(args.score, _truth(args), args.export)))
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
