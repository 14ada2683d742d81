"""Parallel run of a gap study; every case is one file, so that a killed study can resume."""

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from benchmarks.studies.workflow import case
from benchmarks.studies.workflow.case import Row, Vehicle
from benchmarks.studies.workflow.plan import Case, Study, cases
from monitor.base.files.outputs import write_bytes
from training.greybox.fit.case import NAMED
from training.jobs import parallel, run_folder, values

CASES: Final = "cases"
VEHICLES: Final = "vehicles"
MODEL: Final = "base.onnx"
Item = tuple[Case, Vehicle | str, bytes]  # a case, its vehicle, and the file of the vehicle's base
Progress = Callable[[int], None]  # called with the number of newly finished cases


def begin(study: Study, folder: Path) -> dict[str, Any]:
    """Claim the folder for a study; return the study's identity.

    Raises UsageError if the folder holds another study.
    """
    own = identity(study)
    run_folder.claim(folder, own)
    for part in (CASES, VEHICLES):
        (folder / part).mkdir(exist_ok=True)
    return own


def run(study: Study, folder: Path, done: Progress, jobs: int = 1) -> None:
    """Run all cases that the folder does not hold yet.

    done : called with the number of newly finished cases
    """
    planned = {str(each.number): each for each in cases(study)}
    missing = {k: each for k, each in planned.items() if not _path(folder, each).exists()}
    done(len(planned) - len(missing))
    numbers = dict.fromkeys(each.vehicle for each in missing.values())
    new = [(str(n), n) for n in numbers if not _vehicle(folder, n).exists()]
    # Workers return results and this process writes them: a cluster needs no shared file system.
    for key, (found, model) in parallel.run(_prepare, study, new, jobs=jobs):
        _keep(folder, int(key), found, model)
    work = ((key, _item(each, folder)) for key, each in missing.items())
    for key, row in parallel.run(_do, study, work, jobs=jobs):
        run_folder.write_json(_path(folder, missing[key]), row)
        done(1)


def rows(study: Study, folder: Path) -> list[Row]:
    """Return the rows stored in the folder, in the order of the case numbers."""
    found = [_path(folder, each) for each in cases(study)]
    there = [json.loads(path.read_text()) for path in found if path.exists()]
    return sorted(there, key=lambda row: int(row["number"]))


def identity(study: Study) -> dict[str, Any]:
    """Return the study's settings and the digest of all code and numbers behind the rows."""
    return {
        "study": json.loads(json.dumps(asdict(study))),
        "code_sha256": run_folder.code_sha256(Path(__file__).parents[1]),
    }


def _path(folder: Path, asked: Case) -> Path:
    return folder / CASES / f"{asked.number:05d}.json"


def _vehicle(folder: Path, number: int) -> Path:
    return folder / VEHICLES / f"{number}.npz"


def _prepare(study: Study, number: int) -> tuple[Vehicle | str, bytes]:
    """Return a vehicle, or the error as text, and the content of its base model's file."""
    with TemporaryDirectory() as temporary:
        model = Path(temporary) / MODEL
        try:
            return case.prepare(study, number, model), model.read_bytes()
        except Exception as error:  # the vehicle's cases report it; other vehicles go on
            return f"{type(error).__name__}: {error}", b""


def _keep(folder: Path, number: int, vehicle: Vehicle | str, model: bytes) -> None:
    path = _vehicle(folder, number)
    write_bytes(path.with_suffix(".onnx"), model)
    values.save(path, vehicle, NAMED)


def _item(asked: Case, folder: Path) -> Item:
    path = _vehicle(folder, asked.vehicle)
    vehicle: Vehicle | str = values.load(path, Vehicle | str, NAMED)
    prepared = isinstance(vehicle, Vehicle)
    return asked, vehicle, path.with_suffix(".onnx").read_bytes() if prepared else b""


def _do(study: Study, item: Item) -> Row:
    """Return the row of a case; runs on a worker."""
    asked, vehicle, model = item
    with TemporaryDirectory() as temporary:
        if isinstance(vehicle, Vehicle):
            vehicle = replace(vehicle, model=Path(temporary) / MODEL)
            vehicle.model.write_bytes(model)
        return case.run(asked, study, vehicle)
