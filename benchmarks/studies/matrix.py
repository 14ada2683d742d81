"""The detection matrix: how the monitor judges thousands of simulated drives, healthy and faulty.

The drives are vehicles × cycles × weather × faults × severities × placements × repetitions. Repeat
the same command to continue a stopped run; ``--out`` gets the rows, report.html and matrix.json.

    python -m benchmarks matrix --out build/matrix
    python -m benchmarks matrix --out build/late --faults delay_symmetric=0.4 --healthy 20
"""

import argparse
from pathlib import Path
from typing import Final

from tqdm import tqdm

from benchmarks.studies.options import parser_of, plan_of
from benchmarks.studies.sensor import matrix_result, run
from benchmarks.studies.sensor.matrix_page import as_page
from benchmarks.studies.sensor.plan import Matrix
from monitor.base import config
from monitor.base.command_line import command
from monitor.base.command_line import option_paths as paths
from monitor.base.files.outputs import write_text
from monitor.pipeline.replay import shipped_model
from training.jobs import run_folder

REPORT, RESULT = "report.html", "matrix.json"
NAME: Final = "matrix"


def main(argv: list[str]) -> int:
    """Drive the matrix; return the exit code."""
    return command.run(NAME, lambda _: _parser(), argv)


def _parser() -> argparse.ArgumentParser:
    parser = parser_of(NAME, Matrix, __doc__)
    parser.add_argument("--model", type=paths.read, default=shipped_model(), help="model to judge")
    parser.add_argument("--config", type=paths.read, help="TOML file that changes shipped settings")
    parser.set_defaults(func=_run)
    return parser


def _run(args: argparse.Namespace) -> int:
    matrix, model, out = plan_of(Matrix, args), Path(args.model), Path(args.out)
    settings = config.load(args.config)
    with tqdm(total=run.count(matrix), unit="drive", disable=args.nothing or None) as bar:
        rows = run.run(matrix, model, settings, out, bar.update, args.jobs)
    result = matrix_result.result(rows, run_folder.identity_of(out), model.name)
    print(matrix_result.as_text(result))
    write_text(out / REPORT, as_page(result, rows))
    run_folder.write_json(out / RESULT, result, indent=1)
    print(f"report: {out / REPORT}")
    return 0
