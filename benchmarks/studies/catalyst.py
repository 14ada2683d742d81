"""The catalyst matrix: what the monitor says behind the catalyst on many simulated drives.

Each drive has a vehicle of its own. Five of eight drives have a drawn catalyst and sensors, two
have wrong metering or fuel, one is of a second engine. Repeat the same command to continue a
stopped run; ``--out`` gets the rows, catalyst.html and catalyst.json.

    python -m benchmarks catalyst --out build/catalyst
"""

import argparse
from pathlib import Path
from typing import Final

from tqdm import tqdm

from benchmarks.studies.behind import catalyst_page, run, targets
from benchmarks.studies.behind.plan import CatalystMatrix
from benchmarks.studies.options import parser_of, plan_of
from monitor.base import config
from monitor.base.command_line import command
from monitor.base.command_line import option_paths as paths
from monitor.base.files.outputs import write_text
from training.jobs import run_folder

REPORT, RESULT = "catalyst.html", "catalyst.json"
NAME: Final = "catalyst"


def main(argv: list[str]) -> int:
    """Drive the catalyst matrix; return the exit code."""
    return command.run(NAME, lambda _: _parser(), argv)


def _parser() -> argparse.ArgumentParser:
    parser = parser_of(NAME, CatalystMatrix, __doc__)
    parser.add_argument("--config", type=paths.read, help="TOML file that changes shipped settings")
    parser.set_defaults(func=_run)
    return parser


def _run(args: argparse.Namespace) -> int:
    matrix, out = plan_of(CatalystMatrix, args), Path(args.out)
    settings = config.load(args.config)
    with tqdm(total=matrix.drives, unit="drive", disable=args.nothing or None) as bar:
        rows, limits = run.run(matrix, settings, out, bar.update, args.jobs)
    result = catalyst_page.result(rows, limits, run_folder.identity_of(out))
    print(targets.as_text(result))
    write_text(out / REPORT, catalyst_page.as_page(result))
    run_folder.write_json(out / RESULT, result, indent=1)
    print(f"report: {out / REPORT}")
    return 0
