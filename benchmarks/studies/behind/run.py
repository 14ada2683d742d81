"""Parallel run of a catalyst matrix; every chunk is one file, so that a killed run can resume."""

import dataclasses
import hashlib
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from benchmarks.studies.behind import rules
from benchmarks.studies.behind.cases import PERIOD_S, drive, judged
from benchmarks.studies.behind.plan import CatalystMatrix, CatalystTrial, trials
from benchmarks.studies.second import brick as second_catalyst
from benchmarks.studies.sensor.conditions import weather
from monitor.base.config import Config
from monitor.base.types import FloatArray
from training.jobs import parallel, run_folder

CHUNK: Final = 8
LIMITS: Final = "limits.json"
Row = dict[str, Any]


@dataclasses.dataclass(frozen=True, slots=True)
class Bench:
    """What a worker needs beside its trials."""

    config: Config
    seconds: float


def run(
    matrix: CatalystMatrix,
    config: Config,
    folder: Path,
    done: Callable[[int], None],
    jobs: int = 1,
) -> tuple[list[Row], dict[str, float | None]]:
    """Return a row for every drive, and the limits of the rules; stored chunks are not run again.

    done : called with the number of newly finished drives
    Raises UsageError if the folder holds another run, or the plan cannot be driven.
    """
    planned = trials(matrix)
    run_folder.claim(folder, identity(matrix, config))
    limits = folder / LIMITS
    if not limits.exists():
        run_folder.write_json(limits, rules.limits(matrix.seconds))
    chunks = {f"drives_{i:05d}": planned[i : i + CHUNK] for i in range(0, len(planned), CHUNK)}
    paths = {name: folder / f"{name}.json" for name in chunks}
    missing = {name: own for name, own in chunks.items() if not paths[name].exists()}
    done(len(planned) - sum(map(len, missing.values())))
    bench = Bench(config, matrix.seconds)
    for name, rows in parallel.run(_do, bench, missing.items(), jobs=jobs):
        run_folder.write_json(paths[name], rows)
        done(len(rows))
    found = [row for path in paths.values() for row in json.loads(path.read_text())]
    return found, json.loads(limits.read_text())


def identity(matrix: CatalystMatrix, config: Config) -> dict[str, Any]:
    """Return the settings of a run and the digests of configuration and code."""
    settings = json.dumps(dataclasses.asdict(config)).encode()
    return {
        "matrix": json.loads(json.dumps(dataclasses.asdict(matrix))),
        "config_sha256": hashlib.sha256(settings).hexdigest(),
        "code_sha256": run_folder.code_sha256(Path(__file__).parents[1]),
    }


def _do(bench: Bench, chunk: Sequence[CatalystTrial]) -> list[Row]:
    """Drive and judge a chunk on a worker; an error names the drive."""
    rows = []
    for trial in chunk:
        try:
            rows.append(row(trial, bench.config, bench.seconds))
        except Exception as error:
            where = f"catalyst drive {trial.number}, vehicle {trial.vehicle}"
            raise RuntimeError(f"{where}: {type(error).__name__}: {error}") from error
    return rows


def row(trial: CatalystTrial, config: Config, seconds: float) -> Row:
    """Return one drive's truth, what the monitor says of it, and the indices of the rules."""
    names, values, true_g = _samples(trial, seconds)
    indices = rules.indices(names, values, PERIOD_S)
    return (
        trial.as_row()
        | {"true_g": true_g, "driving_s": round(len(values) * PERIOD_S, 3)}
        | judged(names, values, config)
        | {"rules": {k: v if math.isfinite(v) else None for k, v in indices.items()}}
    )


def _samples(trial: CatalystTrial, seconds: float) -> tuple[tuple[str, ...], FloatArray, float]:
    """Return names, samples (n, n_names) and true capacity in g of a drive."""
    case, vehicle = trial.case, trial.vehicle
    if trial.kind != "second":
        outside = weather(trial.ambient, vehicle)
        return drive(vehicle, trial.cycle, case, seconds, outside)
    grams = case.grams or 0.0
    own = second_catalyst.brick(vehicle, grams)._replace(leak=case.leak)
    lag_s = case.sensor_severity or 0.0
    values = second_catalyst.drive(vehicle, vehicle, own, lag_s, case.offset_lambda)
    return second_catalyst.NAMES, values[: round(seconds / PERIOD_S)], grams
