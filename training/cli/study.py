"""The command ``o2train study``: repeat the whole study of the paper on any recordings."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from math import inf
from pathlib import Path
from typing import Annotated

from monitor.base.command_line.parameters import Number, Recordings
from training.cli.options import (
    Folder,
    GridOptions,
    Minutes,
    SeedOption,
    SignalOptions,
    inputs_of,
    load_all,
    warn,
)

EXAMPLES = """examples:
  o2train study drives/*.parquet --test wltc.parquet --faulty slow.parquet --out study
  o2train study run_1*.csv.gz run_3*.csv.gz --test run_000053.csv.gz --out study \\
      --inputs speed_z load_z ignition_angle_z fuel_cutoff_z --output lambda_z

The command writes DIR/report.html, DIR/study.json and DIR/model.onnx, and keeps finished parts in
DIR/parts. Repeat the same command to continue a killed study."""


@dataclass(frozen=True, kw_only=True)
class StudyCommand(SignalOptions, SeedOption, GridOptions):
    """Options of a study.

    recordings : drives of a healthy vehicle, for training
    out : folder for report and model
    test : drives of the healthy vehicle that no training uses; they judge the models
    faulty : drives with sensor faults (default: faults are added to healthy drives)
    steady : drives at steady operating points (default: none, the steady training is left out)
    starts : trainings per model, from different random weights
    iterations : most iterations of a series-parallel training of the 29 models
    samples : most training samples of the 29 models
    models : numbers of the models to train, 1 to 29 (default: all)
    budget : minutes for the model whose memory and size the data choose, as in o2train fit (default
        10); input selection may take 0.4 of the budget more, the training on steady against mixed
        driving 0.6 divided by --jobs, each part of the driving that a calibration takes 0.2
    jobs : number of processes on this machine
    scheduler : run the jobs on the Dask cluster of this scheduler, for example tcp://host:8786
    """

    recordings: Recordings = field(kw_only=False)
    out: Folder
    test: Recordings = ()
    faulty: Recordings = ()
    steady: Recordings = ()
    starts: Number = 3
    iterations: Number = 200
    samples: Number = 20_000
    models: Annotated[Sequence[int], "N"] = ()
    budget: Minutes = 10.0
    jobs: Number = 2
    scheduler: Annotated[str | None, "URL"] = None


def also_written(args: StudyCommand) -> list[Path]:
    """Return the files in the folder that a study writes."""
    return [args.out / name for name in ("report.html", "study.json", "model.onnx")]


def run(args: StudyCommand) -> int:
    """Repeat the study of the paper and report it: data check, preparation, input selection,
    linear baselines, 29 NARX models, closed-loop training, choice of the model, residuals of
    healthy and faulty drives, training on steady against mixed driving.

    Raises RecordingError or UsageError (exit code 2).
    """
    from monitor.base.errors import UsageError
    from monitor.base.signals import OUTPUT
    from training.study.run import study
    from training.study.task import Settings, Task

    wrong = min(args.starts, args.iterations, args.samples, args.jobs, args.seed + 1) < 1
    if wrong or not 0.0 < args.budget < inf:
        wanted = "--starts, --iterations, --samples, --jobs and --budget must be positive"
        raise UsageError(f"{wanted}, --seed at least 0")
    if find_spec("torch") is None:
        raise UsageError("torch is not installed: pip install '.[study]' in the project's folder")
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
    warn(result["warnings"])
    print(result["choice"]["reason"])
    print(f"model: {args.out / 'model.onnx'}")
    print(f"report: {args.out / 'report.html'}")
    return 0
