"""All drives of a matrix in parallel, in chunks that a run begun again finds done."""

import dataclasses
import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Final

from joblib import Parallel, delayed

import monitor
from monitor.batch.judge import Judged
from monitor.config import Config
from monitor.errors import O2Error
from monitor.limits import Limits
from monitor.model import Model
from monitor.reference import Reference
from monitor.types import SampleBlock
from training import run_folder
from training.dyno import ecu
from training.matrix.drive import samples
from training.matrix.judging import from_json, judge_drives, learn, to_json
from training.matrix.plan import Matrix, Trial, calibration, reference_drives, refuse_used, trials
from training.matrix.rows import Row, row
from training.matrix.rules import fitted
from training.recordings import sha256
from training.rules.windows import Rule

CHUNK: Final = 32  # trials side by side; their windows take some megabytes each
VEHICLES: Final = 10  # whose reference drives run side by side
DRIVES: Final = ("plan", "drive", "judging", "rules", "rows", "run")  # modules of this package
References = dict[str, Any]  # vehicle → its reference, as JSON has it
Progress = Callable[[int], None]  # takes how many drives are done more


@dataclass(frozen=True, slots=True)
class Bench:
    """What judges the drives."""

    model_path: Path
    config: Config
    rules: dict[str, Rule]


@dataclass(frozen=True, slots=True)
class Chunk:
    """Drives that are done together; a vehicle's reference drives are, one after the other."""

    name: str
    drives: tuple[Trial, ...]


def run(
    matrix: Matrix, model_path: Path, config: Config, folder: Path, jobs: int, done: Progress
) -> list[Row]:
    """Return a row for every drive, references first; results of the same run are taken up.

    Raises UsageError if the folder holds another run, or if a vehicle or seed was used before.
    """
    planned, references = trials(matrix), reference_drives(matrix)
    card = Model.load(model_path).card
    refuse_used([*chain(*references), *planned], [r.path for r in card.recordings])
    run_folder.claim(folder, identity(matrix, model_path, config))
    bench = Bench(model_path, config, _rules(matrix, model_path, config, jobs))
    first = [
        Chunk(f"reference_{i:05d}", tuple(t for own in references[i : i + VEHICLES] for t in own))
        for i in range(0, len(references) if matrix.reference_drives else 0, VEHICLES)
    ]
    rows, learned = _all(first, bench, {}, folder, jobs, done)
    second = [
        Chunk(f"trials_{i:05d}", tuple(planned[i : i + CHUNK]))
        for i in range(0, len(planned), CHUNK)
    ]
    return rows + _all(second, bench, learned, folder, jobs, done)[0]


def count(matrix: Matrix) -> int:
    """Return how many drives a run takes, without those that set the literature's rules."""
    return len(trials(matrix)) + matrix.vehicles * matrix.reference_drives


def identity(matrix: Matrix, model_path: Path, config: Config) -> dict[str, Any]:
    """Return what a run's results depend on."""
    tree = {"matrix": dataclasses.asdict(matrix), "config": dataclasses.asdict(config)}
    return {
        "matrix": json.loads(json.dumps(tree["matrix"])),
        "model_sha256": sha256(model_path),
        "config_sha256": hashlib.sha256(json.dumps(tree["config"]).encode()).hexdigest(),
        "code_sha256": _code_sha256(),
    }


def _code_sha256() -> str:
    """Return the digest of all that drives and judges, not of what makes tables of it."""
    at, matrix = Path(monitor.__file__).parent, Path(__file__).parent
    paths = [*at.rglob("*.py"), *at.glob("*.toml")]
    paths += [*matrix.parent.glob("dyno/*.py"), *matrix.parent.glob("rules/*.py")]
    paths += [matrix / f"{name}.py" for name in DRIVES]
    return run_folder.code_sha256(paths, at.parent)


def _rules(matrix: Matrix, model_path: Path, config: Config, jobs: int) -> dict[str, Rule]:
    good, bad = calibration(matrix)
    every = [*good, *bad]
    size = -(-len(every) // jobs)
    judged = Parallel(jobs)(
        delayed(_judge)(every[i : i + size], model_path, config) for i in range(0, len(every), size)
    )
    windows = [drive.windows for part in judged for _, drive in part]
    limits = _limits(model_path, config)
    return fitted(windows[: len(good)], windows[len(good) :], limits)


def _all(
    chunks: Sequence[Chunk],
    bench: Bench,
    learned: References,
    folder: Path,
    jobs: int,
    done: Progress,
) -> tuple[list[Row], References]:
    """Return rows in the order of the chunks, and the references that they learn."""
    missing = []
    for chunk in chunks:
        if (folder / f"{chunk.name}.json").exists():
            done(len(chunk.drives))
        else:
            missing.append(chunk)
    work = (delayed(_do)(chunk, bench, learned, folder) for chunk in missing)
    for n_drives in Parallel(jobs, return_as="generator_unordered")(work):
        done(n_drives)
    rows: list[Row] = []
    references: References = {}
    for chunk in chunks:
        found = json.loads((folder / f"{chunk.name}.json").read_text())
        rows += found["rows"]
        references |= found["references"]
    return rows, references


def _do(chunk: Chunk, bench: Bench, learned: References, folder: Path) -> int:
    """Do a chunk and write its results; return the number of its drives."""
    rows: list[Row] = []
    references: dict[str, Reference | None] = {
        key: from_json(tree) for key, tree in learned.items()
    }
    learning = chunk.drives[0].kind == "reference"
    for drives in _rounds(chunk) if learning else [chunk.drives]:
        own = [references.get(str(trial.vehicle)) for trial in drives]
        judged = _judge(drives, bench.model_path, bench.config, own)
        for trial, reference, (block, drive) in zip(drives, own, judged, strict=True):
            rows.append(row(trial, block, drive, bench.rules))
            if learning:
                references[str(trial.vehicle)] = learn(reference, drive, bench.config)
    found = {key: to_json(each) for key, each in references.items() if each} if learning else {}
    path = folder / f"{chunk.name}.json"
    run_folder.write_json(path, {"rows": rows, "references": found})
    return len(chunk.drives)


def _rounds(chunk: Chunk) -> Iterator[tuple[Trial, ...]]:
    """Yield the first drive of every vehicle, then the second."""
    vehicles = dict.fromkeys(trial.vehicle for trial in chunk.drives)
    own = [[t for t in chunk.drives if t.vehicle == vehicle] for vehicle in vehicles]
    yield from zip(*own, strict=True)


def _judge(
    drives: Sequence[Trial],
    model_path: Path,
    config: Config,
    references: Sequence[Reference | None] | None = None,
) -> list[tuple[SampleBlock, Judged]]:
    """Return what the monitor saw and said of each drive; an error names the drive."""
    model, bus_map = Model.load(model_path), ecu.own_bus()
    blocks = []
    for trial in drives:
        try:
            blocks.append(samples(trial, bus_map, model.card.period_ns))
        except Exception as error:
            raise RuntimeError(f"{trial.name}: {type(error).__name__}: {error}") from error
    limits = _limits(model_path, config, model)
    try:
        judged = judge_drives(blocks, bus_map.names, model, limits, config, references)
    except O2Error:  # a model that cannot judge these drives
        raise
    except Exception as error:
        between = f"{drives[0].name} to {drives[-1].name}"
        raise RuntimeError(f"{between}: {type(error).__name__}: {error}") from error
    return list(zip(blocks, judged, strict=True))


def _limits(model_path: Path, config: Config, model: Model | None = None) -> Limits:
    card = (model or Model.load(model_path)).card
    return Limits.from_card(card, config, str(model_path))
