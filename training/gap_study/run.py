"""All cases of a study in parallel, each in a file that a run begun again finds done."""

import json
import pickle
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

from joblib import Parallel, delayed

import monitor
from training import run_folder
from training.gap_study import case
from training.gap_study.case import Row, Vehicle
from training.gap_study.plan import Case, Study, cases

CASES: Final = "cases"
VEHICLES: Final = "vehicles"
Progress = Callable[[int], None]  # takes how many cases are done more


def begin(study: Study, folder: Path) -> dict[str, Any]:
    """Take the folder for a study; return what its rows depend on.

    Raises UsageError if the folder holds another study.
    """
    own = identity(study)
    run_folder.claim(folder, own)
    for part in (CASES, VEHICLES):
        (folder / part).mkdir(exist_ok=True)
    return own


def run(study: Study, folder: Path, jobs: int, done: Progress) -> None:
    """Do all cases that the folder does not hold."""
    planned = cases(study)
    missing = [each for each in planned if not _path(folder, each).exists()]
    done(len(planned) - len(missing))
    numbers = dict.fromkeys(each.vehicle for each in missing)
    new = [number for number in numbers if not _pickle(folder, number).exists()]
    Parallel(jobs)(delayed(_prepare)(study, number, folder) for number in new)
    work = (delayed(_do)(each, study, folder) for each in missing)
    for _ in Parallel(jobs, return_as="generator_unordered")(work):
        done(1)


def rows(study: Study, folder: Path) -> list[Row]:
    """Return the rows that a folder holds, in the order of the plan's numbers."""
    found = [_path(folder, each) for each in cases(study)]
    there = [json.loads(path.read_text()) for path in found if path.exists()]
    return sorted(there, key=lambda row: int(row["number"]))


def identity(study: Study) -> dict[str, Any]:
    """Return what the rows depend on."""
    root = Path(monitor.__file__).parent.parent
    paths = run_folder.sources(Path(case.__file__), root)
    return {
        "study": json.loads(json.dumps(asdict(study))),
        "code_sha256": run_folder.code_sha256(paths, root),
    }


def _path(folder: Path, asked: Case) -> Path:
    return folder / CASES / f"{asked.number:05d}.json"


def _pickle(folder: Path, vehicle: int) -> Path:
    return folder / VEHICLES / f"{vehicle}.pickle"


def _prepare(study: Study, number: int, folder: Path) -> None:
    path = _pickle(folder, number)
    begun = path.with_suffix(".begun")
    try:
        found: Vehicle | str = case.prepare(study, number, path.with_suffix(".onnx"))
    except Exception as error:  # its cases say so, the others go on
        found = f"{type(error).__name__}: {error}"
    begun.write_bytes(pickle.dumps(found))
    begun.replace(path)


def _do(asked: Case, study: Study, folder: Path) -> None:
    path = _pickle(folder, asked.vehicle)
    vehicle: Vehicle | str = pickle.loads(path.read_bytes())
    if isinstance(vehicle, Vehicle):  # the folder may have been moved
        vehicle = replace(vehicle, model=path.with_suffix(".onnx"))
    run_folder.write_json(_path(folder, asked), case.run(asked, study, vehicle))
