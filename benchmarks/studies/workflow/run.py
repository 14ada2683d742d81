"""Run of a gap study: its vehicles are prepared first, then every case is a chunk."""

import pickle
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.studies.runner import Found, Place
from benchmarks.studies.workflow import case
from benchmarks.studies.workflow.case import Vehicle
from benchmarks.studies.workflow.plan import Case, Study, cases
from monitor.base.files.outputs import write_bytes


@dataclass(frozen=True, slots=True)
class Shed:
    """A study and the folder with its vehicles; a text instead of a vehicle says what failed."""

    study: Study
    folder: Path

    def model(self, number: int) -> Path:
        """Return the file of a vehicle's base model."""
        return self.folder / f"{number}.onnx"

    def keep(self, number: int, vehicle: Vehicle | str) -> None:
        """Write a vehicle beside its base model."""
        write_bytes(self.folder / f"{number}.pickle", pickle.dumps(vehicle))

    def take(self, number: int) -> Vehicle | str:
        """Return a vehicle that was written."""
        found: Vehicle | str = pickle.loads((self.folder / f"{number}.pickle").read_bytes())
        return replace(found, model=self.model(number)) if isinstance(found, Vehicle) else found


def run(study: Study, place: Place) -> None:
    """Prepare the vehicles and run all cases that the place does not hold yet."""
    shed, planned = Shed(study, place.folder / "vehicles"), cases(study)
    shed.folder.mkdir(exist_ok=True)
    numbers = dict.fromkeys(each.vehicle for each in planned)
    place.do(_prepare, shed, {f"vehicle_{n:05d}": n for n in numbers})
    place.do(_answer, shed, {f"case_{each.number:05d}": each for each in planned})


def _prepare(shed: Shed, number: int) -> Found:
    try:
        shed.keep(number, case.prepare(shed.study, number, shed.model(number)))
    except Exception as error:  # the vehicle's cases report it; other vehicles go on
        shed.keep(number, f"{type(error).__name__}: {error}")
    return {"rows": []}


def _answer(shed: Shed, asked: Case) -> Found:
    return {"rows": [case.run(asked, shed.study, shed.take(asked.vehicle))]}
