"""The command ``o2train study``: repeat the whole study of the paper on any recordings."""

import argparse
import sys
from typing import Any

from monitor.base.command_line import option_paths as paths
from training.cli.recordings import (
    add_bus_options,
    add_period_option,
    add_signal_options,
    inputs_of,
    load_all,
)
from training.cli.seeds import add_seed_option, check_seed

_EXAMPLES = """examples:
  o2train study drives/*.parquet --test wltc.parquet --faulty slow.parquet --out study
  o2train study run_1*.csv.gz run_3*.csv.gz --test run_000053.csv.gz --out study \\
      --inputs speed_z load_z ignition_angle_z fuel_cutoff_z --output lambda_z

The command writes DIR/report.html, DIR/study.json and DIR/model.onnx, and keeps finished parts in
DIR/parts. Repeat the same command to continue a killed study."""


def add_parsers(subparsers: "argparse._SubParsersAction[Any]") -> None:
    """Add the command ``study`` to ``subparsers``."""
    study = subparsers.add_parser(
        "study",
        help="repeat the whole study of the paper on recordings",
        description="Repeat the study of the paper and report it: data check, preparation, input\n"
        "selection, linear baselines, 29 NARX models, closed-loop training, choice of the model,\n"
        "residuals of healthy and faulty drives, training on steady against mixed driving.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_drives(study)
    add_signal_options(study)
    _add_effort(study)
    _add_machines(study)
    add_period_option(study)
    add_bus_options(study)
    study.set_defaults(
        func=run,
        also_written=lambda args: [
            args.out / name for name in ("report.html", "study.json", "model.onnx")
        ],
    )


def _add_drives(parser: argparse.ArgumentParser) -> None:
    """Add the recordings by their role."""
    parser.add_argument(
        "recordings",
        nargs="+",
        type=paths.read,
        metavar="RECORDING",
        help="drives of a healthy vehicle, for training",
    )
    parser.add_argument(
        "--out", type=paths.folder, required=True, metavar="DIR", help="folder for report and model"
    )
    for name, text in (
        ("test", "drives of the healthy vehicle that no training uses; they judge the models"),
        ("faulty", "drives with sensor faults (default: faults are added to healthy drives)"),
        (
            "steady",
            "drives at steady operating points (default: steady stretches of the recordings)",
        ),
    ):
        parser.add_argument(
            f"--{name}", nargs="+", type=paths.read, default=[], metavar="RECORDING", help=text
        )


def _add_effort(parser: argparse.ArgumentParser) -> None:
    """Add the number and length of the trainings."""
    parser.add_argument(
        "--starts",
        type=int,
        default=3,
        metavar="N",
        help="trainings per model, from different random weights (default 3)",
    )
    parser.add_argument(
        "--iterations",
        type=int,
        default=200,
        metavar="N",
        help="most iterations of a series-parallel training of the 29 models (default 200)",
    )
    parser.add_argument(
        "--samples",
        type=int,
        default=20_000,
        metavar="N",
        help="most training samples of the 29 models (default 20000)",
    )
    parser.add_argument(
        "--models",
        type=int,
        nargs="+",
        default=[],
        metavar="N",
        help="numbers of the models to train, 1 to 29 (default: all)",
    )
    parser.add_argument(
        "--budget",
        type=float,
        default=10.0,
        metavar="MIN",
        help="minutes for the model whose memory and size the data choose, as in o2train fit "
        "(default 10); input selection may take 0.4 of the budget more, the training on steady "
        "against mixed driving 0.6 divided by --jobs",
    )
    add_seed_option(parser)


def _add_machines(parser: argparse.ArgumentParser) -> None:
    """Add where the trainings run."""
    parser.add_argument(
        "--jobs",
        type=int,
        default=2,
        metavar="N",
        help="number of processes on this machine (default 2)",
    )
    parser.add_argument(
        "--scheduler",
        metavar="URL",
        help="run the jobs on the Dask cluster of this scheduler, for example tcp://host:8786",
    )


def run(args: argparse.Namespace) -> int:
    """Run the study, write report and model, and return exit code 0.

    Raises RecordingError or UsageError (exit code 2).
    """
    from monitor.base.errors import UsageError
    from monitor.base.signals import OUTPUT
    from training.study.run import study
    from training.study.task import Settings, Task

    if min(args.starts, args.iterations, args.samples, args.jobs) < 1 or not args.budget > 0:
        raise UsageError("--starts, --iterations, --samples, --jobs and --budget must be positive")
    check_seed(args)
    settings = Settings(
        starts=args.starts,
        iterations=args.iterations,
        n_samples=args.samples,
        budget_minutes=args.budget,
        seed=args.seed,
        models=tuple(args.models),
    )
    recordings = tuple(load_all(args, args.recordings, args.period))
    task = Task(
        recordings=recordings,
        test=tuple(load_all(args, args.test, args.period)),
        faulty=tuple(load_all(args, args.faulty, args.period)),
        steady=tuple(load_all(args, args.steady, args.period)),
        inputs=inputs_of(args, recordings),
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
