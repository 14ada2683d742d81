"""The catalyst matrix: what the monitor says behind the catalyst on many simulated drives.

Each drive has a vehicle of its own. Five of eight drives have a drawn catalyst and sensors, two
have wrong metering or fuel, one is of a second engine. Repeat the same command to continue a
stopped run; ``--out`` gets rows, report.html and catalyst.json.

    python -m benchmarks catalyst --out build/catalyst
"""

import argparse
from functools import partial

from benchmarks.studies import runner
from benchmarks.studies.behind import run, tables
from benchmarks.studies.behind.plan import CatalystMatrix, trials
from benchmarks.studies.options import parser_of, plan_of
from monitor.base import config
from monitor.base.command_line import command
from monitor.base.command_line import option_paths as paths


def main(argv: list[str]) -> int:
    """Drive the catalyst matrix; return the exit code."""
    parser = parser_of("catalyst", CatalystMatrix, __doc__, _run)
    parser.add_argument("--config", type=paths.read, help="TOML file that changes shipped settings")
    return command.run("catalyst", lambda _: parser, argv)


def _run(args: argparse.Namespace) -> int:
    matrix, settings = plan_of(CatalystMatrix, args), config.load(args.config)
    total, digest = len(trials(matrix)) + 1, runner.config_sha256(settings)
    made = partial(tables.report, matrix)
    with runner.running("catalyst", args, matrix, total, made, config_sha256=digest) as place:
        run.run(matrix, settings, place)
    return 0
