"""Subcommand ``o2train study``: the paper's whole study on any recordings."""

import argparse
import sys
from pathlib import Path
from typing import Any

from training.cli.recordings import add_bus_options, add_period_option, add_signal_options, load_all

_EXAMPLES = """examples:
  o2train study drives/*.parquet --test wltc.parquet --faulty slow.parquet --out study
  o2train study run_1*.csv.gz run_3*.csv.gz --test run_000053.csv.gz --out study \\
      --inputs speed_z load_z ignition_angle_z fuel_cutoff_z --output lambda_z

Writes DIR/report.html, DIR/study.json and DIR/model.onnx; finished parts are kept in DIR/parts. To
continue a stopped study, give the same command again."""


def add_parsers(subparsers: "argparse._SubParsersAction[Any]") -> None:
    """Add the subcommand ``study``."""
    study = subparsers.add_parser(
        "study",
        help="run the paper's whole study on recordings and write one report",
        description="Data check, preparation, input selection, linear baselines, 29 NARX models, "
        "closed-loop training, choice of a model, healthy and faulty residuals, and training on "
        "steady against mixed driving.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    study.add_argument("recordings", nargs="+", type=Path, metavar="RECORDING")
    study.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write")
    for name, text in (
        ("test", "held-out drives of the healthy vehicle, used only for scores"),
        ("faulty", "drives with sensor faults (default: faults are added to the healthy drives)"),
        ("steady", "steady operating points (default: steady stretches of the recordings)"),
    ):
        study.add_argument(
            f"--{name}", nargs="+", type=Path, default=[], metavar="RECORDING", help=text
        )
    add_signal_options(study)
    study.add_argument(
        "--starts", type=int, default=3, metavar="N", help="trainings per model (default: 3)"
    )
    study.add_argument(
        "--iterations",
        type=int,
        default=200,
        metavar="N",
        help="most iterations of a series-parallel training of the 29 models (default: 200)",
    )
    study.add_argument(
        "--samples",
        type=int,
        default=20_000,
        metavar="N",
        help="most training samples of the 29 models (default: 20000)",
    )
    study.add_argument(
        "--models",
        type=int,
        nargs="+",
        default=[],
        metavar="N",
        help="numbers of the models to train, of the 29 (default: all)",
    )
    study.add_argument(
        "--budget",
        type=float,
        default=10.0,
        metavar="MIN",
        help="minutes for the model whose lags and size the data choose, as in fit (default: 10); "
        "input selection takes up to 0.4 of it more, steady against mixed up to 0.6 over --jobs",
    )
    study.add_argument(
        "--seed", type=int, default=0, metavar="N", help="seed of weights and blocks (default: 0)"
    )
    study.add_argument(
        "--jobs", type=int, default=2, metavar="N", help="number of processes (default: 2)"
    )
    study.add_argument("--scheduler", metavar="URL", help="Dask scheduler, tcp://host:port")
    add_period_option(study)
    add_bus_options(study)
    study.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Run the study; return the exit code.

    Raises RecordingError or UsageError (exit code 2).
    """
    from monitor.base.errors import UsageError
    from monitor.base.signals import NARX_INPUTS, OUTPUT
    from training.studies.paper.run import study
    from training.studies.paper.task import Settings, Task

    if min(args.starts, args.iterations, args.samples, args.jobs) < 1 or not args.budget > 0:
        raise UsageError("--starts, --iterations, --samples, --jobs and --budget must be positive")
    if args.seed < 0:
        raise UsageError("--seed is at least 0")
    if args.out.exists() and not args.out.is_dir():
        raise UsageError(f"--out {args.out}: is a file, a folder is wanted")
    settings = Settings(
        args.starts, args.iterations, args.samples, args.budget, args.seed, tuple(args.models)
    )
    task = Task(
        recordings=tuple(load_all(args, args.recordings, args.period)),
        test=tuple(load_all(args, args.test, args.period)),
        faulty=tuple(load_all(args, args.faulty, args.period)),
        steady=tuple(load_all(args, args.steady, args.period)),
        inputs=tuple(args.inputs or NARX_INPUTS),
        output=args.output or OUTPUT,
        out=args.out,
        settings=settings,
        jobs=args.jobs,
        scheduler=args.scheduler,
    )
    result = study(task, lambda line: print(line, flush=True))
    for warning in result["warnings"]:
        print(f"o2train: warning: {warning}", file=sys.stderr)
    print(result["choice"]["reason"])
    print(f"model: {args.out / 'model.onnx'}")
    print(f"report: {args.out / 'report.html'}")
    return 0
