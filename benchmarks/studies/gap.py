"""The gap study: hide effects and sensor faults in simulated vehicles and count the right answers.

The gap workflow answers every case. Repeat the same command to continue a stopped run; ``--out``
gets rows, vehicles, report.html and gap.json.

    python -m benchmarks gap --out study
    python -m benchmarks gap --out study --base narx --cases effect=80 fault=20
"""

import argparse
from functools import partial

from benchmarks.studies import runner
from benchmarks.studies.options import parser_of, plan_of
from benchmarks.studies.workflow import run, tables
from benchmarks.studies.workflow.plan import Study
from monitor.base.command_line import command


def main(argv: list[str]) -> int:
    """Run the study; return the exit code."""
    return command.run("gap", lambda _: parser_of("gap", Study, __doc__, _run), argv)


def _run(args: argparse.Namespace) -> int:
    study = plan_of(Study, args)
    made = partial(tables.report, study)
    with runner.running("gap", args, study, study.count, made) as place:
        run.run(study, place)
    return 0
