"""The detection matrix: how the monitor judges thousands of simulated drives, healthy and faulty.

The drives are vehicles × cycles × weather × faults × severities × placements × repetitions. Repeat
the same command to continue a stopped run; ``--out`` gets rows, report.html and matrix.json.

    python -m benchmarks matrix --out build/matrix
    python -m benchmarks matrix --out build/late --faults delay_symmetric=0.4 --healthy 20
"""

import argparse
from functools import partial

from benchmarks.studies import runner
from benchmarks.studies.options import parser_of, plan_of
from benchmarks.studies.sensor import run, tables
from benchmarks.studies.sensor.plan import Matrix
from monitor.base import config
from monitor.base.command_line import command
from monitor.base.command_line import option_paths as paths
from monitor.base.files.manifest import sha256_of
from monitor.pipeline.replay import shipped_model


def main(argv: list[str]) -> int:
    """Drive the matrix; return the exit code."""
    parser = parser_of("matrix", Matrix, __doc__, _run)
    parser.add_argument("--model", type=paths.read, default=shipped_model(), help="model to judge")
    parser.add_argument("--config", type=paths.read, help="TOML file that changes shipped settings")
    return command.run("matrix", lambda _: parser, argv)


def _run(args: argparse.Namespace) -> int:
    matrix, settings = plan_of(Matrix, args), config.load(args.config)
    chunks = run.chunks(matrix, args.model)
    total = sum(chunk.count for chunk in chunks.values())
    made = partial(tables.report, matrix, args.model.name)
    digests = {
        "model_sha256": sha256_of(args.model),
        "config_sha256": runner.config_sha256(settings),
    }
    with runner.running("matrix", args, matrix, total, made, **digests) as place:
        run.run(matrix, chunks, args.model, settings, place)
    return 0
