"""The gap study: hide effects and sensor faults in simulated vehicles and count the right answers.

The gap workflow answers every case. Repeat the same command to continue a stopped run; ``--out``
gets the cases, report.html and gap.json. ``--export`` writes a challenge for others instead:
recordings of every case and of its healthy vehicle, and the hash of the truth, which is written
beside as DIR-truth.json; vehicles and seeds are drawn in secret. ``--score`` counts the right
answers of a challenge.

    python -m benchmarks gap --out study
    python -m benchmarks gap --out study --base narx --cases effect=80 fault=20
    python -m benchmarks gap --export challenge --vehicles 4 --cases effect=20 null=10 fault=5
    python -m benchmarks gap --score answers.json --export challenge
"""

import argparse
from pathlib import Path
from typing import Final

from tqdm import tqdm

from benchmarks.studies.options import parser_of, plan_of
from benchmarks.studies.workflow import challenge, gap_study_result, run
from benchmarks.studies.workflow.gap_study_page import as_page
from benchmarks.studies.workflow.plan import Study
from monitor.base.command_line import command
from monitor.base.command_line import option_paths as paths
from monitor.base.errors import UsageError
from monitor.base.files.outputs import write_text
from training.jobs import run_folder

REPORT, RESULT = "report.html", "gap.json"
NAME: Final = "gap"


def main(argv: list[str]) -> int:
    """Run the study, write a challenge or score answers; return the exit code."""
    return command.run(NAME, lambda _: _parser(), argv)


def _parser() -> argparse.ArgumentParser:
    parser = parser_of(NAME, Study, __doc__)
    parser.add_argument("--export", type=paths.folder, metavar="DIR", help="write a challenge")
    parser.add_argument("--score", type=paths.read, metavar="ANSWERS", help="count right answers")
    parser.add_argument(
        "--truth", type=paths.read, metavar="FILE", help="truth (DIR-truth.json of --export DIR)"
    )
    parser.set_defaults(func=_run)
    return parser


def _run(args: argparse.Namespace) -> int:
    if args.score or args.export:
        return _challenge(args)
    study, out = plan_of(Study, args), Path(args.out)
    identity = run.begin(study, out)
    try:
        with tqdm(total=study.count, unit="case", disable=args.nothing or None) as bar:
            run.run(study, out, bar.update, args.jobs)
    finally:
        rows = run.rows(study, out)
        print(gap_study_result.as_text(rows, study))
        write_text(out / REPORT, as_page(rows, study, identity))
        result = gap_study_result.result(rows, study, identity)
        run_folder.write_json(out / RESULT, result, indent=1)
        print(f"report: {out / REPORT}")
    return 0


def _challenge(args: argparse.Namespace) -> int:
    if args.truth is None and args.export is None:
        raise UsageError("--score needs --truth FILE or --export DIR")
    truth = args.truth or args.export.with_name(f"{args.export.name}-truth.json")
    if args.score:
        print(challenge.as_text(challenge.score(args.score, truth, args.export)))
        return 0
    args.out = args.export
    study = challenge.secret(plan_of(Study, args))
    with tqdm(unit="folder", disable=args.nothing or None) as bar:
        digest = challenge.export(study, args.export, truth, bar.update)
    print(f"challenge: {args.export}\ntruth: {truth}, sha256 {digest}")
    return 0
