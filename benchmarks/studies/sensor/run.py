"""Parallel run of a detection matrix; every chunk is one file, so that a killed run can resume."""

import dataclasses
import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, Final

from benchmarks.studies.rules.alarms import fitted
from benchmarks.studies.rules.windows import Rule
from benchmarks.studies.sensor.drive import samples
from benchmarks.studies.sensor.plan import (
    Matrix,
    Trial,
    calibration,
    reference_drives,
    refuse_used,
    trials,
)
from benchmarks.studies.sensor.rows import Row, row
from benchmarks.studies.sensor.verdicts import from_json, judge_drives, learn, to_json
from monitor.base.config import Config
from monitor.base.errors import O2Error
from monitor.base.types import SampleBlock
from monitor.judge.findings import WindowJudged
from monitor.judge.limits import Limits
from monitor.memory.reference import Reference
from monitor.model.step import Model
from monitor.pipeline.side_by_side import Judged
from training.dyno import ecu
from training.jobs import parallel, run_folder
from training.jobs.model_bytes import model_of
from training.recordings.recording import sha256

CHUNK: Final = 32  # trials per chunk; the windows of one trial take some megabytes
VEHICLES: Final = 10  # vehicles per chunk of reference drives
References = dict[str, Any]  # vehicle number → reference as JSON values
Progress = Callable[[int], None]  # called with the number of newly finished drives


@dataclass(frozen=True, slots=True)
class Bench:
    """Model, configuration, rules and references, in a form that can be sent to a worker."""

    model_name: str
    model: bytes  # content of the model file
    config: Config
    rules: dict[str, Rule] = field(default_factory=dict)
    learned: References = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Chunk:
    """Drives that one worker does together; a vehicle's reference drives stay in one chunk."""

    name: str
    drives: tuple[Trial, ...]


def run(
    matrix: Matrix,
    model_path: Path,
    config: Config,
    folder: Path,
    done: Progress,
    jobs: int = 1,
) -> list[Row]:
    """Return a row for every drive, reference drives first; stored chunks are not run again.

    done : called with the number of newly finished drives
    Raises UsageError if the folder holds another run, if the model or the rules were fitted with
    one of the vehicles or seeds.
    """
    planned, references = trials(matrix), reference_drives(matrix)
    card = Model.load(model_path).card
    refuse_used([*chain(*references), *planned], [r.path for r in card.recordings])
    run_folder.claim(folder, identity(matrix, model_path, config))
    bench = Bench(model_path.name, model_path.read_bytes(), config)
    bench = replace(bench, rules=_rules(matrix, bench, jobs))
    first = [
        Chunk(f"reference_{i:05d}", tuple(t for own in references[i : i + VEHICLES] for t in own))
        for i in range(0, len(references) if matrix.reference_drives else 0, VEHICLES)
    ]
    rows, learned = _all(first, bench, folder, jobs, done)
    second = [
        Chunk(f"trials_{i:05d}", tuple(planned[i : i + CHUNK]))
        for i in range(0, len(planned), CHUNK)
    ]
    return rows + _all(second, replace(bench, learned=learned), folder, jobs, done)[0]


def count(matrix: Matrix) -> int:
    """Return the number of drives of a run; drives that set the literature's rules do not count."""
    return len(trials(matrix)) + matrix.vehicles * matrix.reference_drives


def identity(matrix: Matrix, model_path: Path, config: Config) -> dict[str, Any]:
    """Return the settings of a run and the digests of model, configuration and code."""
    tree = {"matrix": dataclasses.asdict(matrix), "config": dataclasses.asdict(config)}
    return {
        "matrix": json.loads(json.dumps(tree["matrix"])),
        "model_sha256": sha256(model_path),
        "config_sha256": hashlib.sha256(json.dumps(tree["config"]).encode()).hexdigest(),
        "code_sha256": run_folder.code_sha256(Path(__file__).parents[1]),
    }


def _rules(matrix: Matrix, bench: Bench, jobs: int) -> dict[str, Rule]:
    good, bad = calibration(matrix)
    every = [*good, *bad]
    parts = {str(i): tuple(every[i : i + CHUNK]) for i in range(0, len(every), CHUNK)}
    found = dict(parallel.run(_windows, bench, parts.items(), jobs=jobs))
    windows = [drive for key in parts for drive in found[key]]
    limits = _limits(model_of(bench.model_name, bench.model), bench)
    return fitted(windows[: len(good)], windows[len(good) :], limits)


def _windows(bench: Bench, drives: Sequence[Trial]) -> list[list[WindowJudged]]:
    """Return a list of windows for every drive."""
    return [judged.windows for _, judged in _judge(drives, bench)]


def _all(
    chunks: Sequence[Chunk], bench: Bench, folder: Path, jobs: int, done: Progress
) -> tuple[list[Row], References]:
    """Return the rows in the order of the chunks, and the references learned in them."""
    missing = {}
    for chunk in chunks:
        if (folder / f"{chunk.name}.json").exists():
            done(len(chunk.drives))
        else:
            missing[chunk.name] = chunk
    # Workers return results and this process writes them: a cluster needs no shared file system.
    for name, result in parallel.run(_do, bench, missing.items(), jobs=jobs):
        run_folder.write_json(folder / f"{name}.json", result)
        done(len(missing[name].drives))
    rows: list[Row] = []
    references: References = {}
    for chunk in chunks:
        found = json.loads((folder / f"{chunk.name}.json").read_text())
        rows += found["rows"]
        references |= found["references"]
    return rows, references


def _do(bench: Bench, chunk: Chunk) -> dict[str, Any]:
    """Run a chunk on a worker; return its rows and, for reference drives, the references."""
    rows: list[Row] = []
    references: dict[str, Reference | None] = {
        key: from_json(tree) for key, tree in bench.learned.items()
    }
    learning = chunk.drives[0].kind == "reference"
    for drives in _rounds(chunk) if learning else [chunk.drives]:
        own = [references.get(str(trial.vehicle)) for trial in drives]
        judged = _judge(drives, bench, own)
        for trial, reference, (block, drive) in zip(drives, own, judged, strict=True):
            rows.append(row(trial, block, drive, bench.rules))
            if learning:
                references[str(trial.vehicle)] = learn(reference, drive, bench.config)
    found = {key: to_json(each) for key, each in references.items() if each} if learning else {}
    return {"rows": rows, "references": found}


def _rounds(chunk: Chunk) -> Iterator[tuple[Trial, ...]]:
    """Yield the first drive of every vehicle, then the second."""
    vehicles = dict.fromkeys(trial.vehicle for trial in chunk.drives)
    own = [[t for t in chunk.drives if t.vehicle == vehicle] for vehicle in vehicles]
    yield from zip(*own, strict=True)


def _judge(
    drives: Sequence[Trial], bench: Bench, references: Sequence[Reference | None] | None = None
) -> list[tuple[SampleBlock, Judged]]:
    """Return samples and verdict of every drive; an error names the drive."""
    model, bus_map = model_of(bench.model_name, bench.model), ecu.own_bus()
    blocks = []
    for trial in drives:
        try:
            blocks.append(samples(trial, bus_map, model.card.period_ns))
        except Exception as error:
            raise RuntimeError(f"{trial.name}: {type(error).__name__}: {error}") from error
    limits = _limits(model, bench)
    try:
        judged = judge_drives(
            blocks,
            bus_map.names,
            model=model,
            limits=limits,
            config=bench.config,
            references=references,
        )
    except O2Error:  # the model cannot judge these drives
        raise
    except Exception as error:
        between = f"{drives[0].name} to {drives[-1].name}"
        raise RuntimeError(f"{between}: {type(error).__name__}: {error}") from error
    return list(zip(blocks, judged, strict=True))


def _limits(model: Model, bench: Bench) -> Limits:
    return Limits.from_card(model.card, bench.config, bench.model_name)
