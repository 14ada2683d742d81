"""Stored cases: drives are simulated once, any version of the code answers them.

A folder holds the healthy drives of each vehicle, ``VEHICLE.pickle``, and cases, ``case_*.pickle``.
"""

import pickle
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.gap_cases.answers import Answer
from benchmarks.outcome import say
from benchmarks.studies.workflow import drive as dyno
from benchmarks.studies.workflow import plan
from monitor.base.types import FloatArray
from training.gap.name.naming import name
from training.gap.name.verdict import Naming
from training.greybox.chain import Constants
from training.greybox.fit.drive import ChainDrive, from_recording, phi_of
from training.healthy import yardstick
from training.healthy.behaviour import Healthy
from training.jobs import run_folder

DYNO_DRIVES: Final = 4  # of a case
Made = Iterator[tuple[str, Callable[[], Any]]]  # name of a file, and what makes its content


class Size(NamedTuple):
    """How much is simulated."""

    length_s: float = 300.0  # of a drive
    healthy: int = 8  # drives of a vehicle of the second engine
    case: int = 6  # drives of one of its cases


WHOLE: Final = Size()
SMALLEST: Final = Size(120.0, 3, 2)


@dataclass(frozen=True, slots=True)
class Stored:
    """One case as it lies on the disk."""

    key: str
    vehicle: str
    kind: str
    hidden: tuple[str, ...]
    size: float
    drives: list[ChainDrive]
    sound: list[ChainDrive]  # the same drives with nothing hidden


@contextmanager
def place(folder: Path | None) -> Iterator[Path]:
    """Give the folder, or one for the while."""
    with tempfile.TemporaryDirectory() as spare:
        yield folder or Path(spare)


def make(folder: Path, made: Made, only: str) -> None:
    """Simulate the cases with ``only`` in their keys that the folder lacks, and their vehicles."""
    folder.mkdir(parents=True, exist_ok=True)
    content = dict(made)
    cases = [key for key in content if key.startswith("case_") and only in key]
    vehicles = {key for key in content if any(f"case_{key}_" in case for case in cases)}
    if any(case.startswith("case_dyno_") for case in cases):
        vehicles |= {key for key in content if key.startswith("dyno_")}
    for key in (*sorted(vehicles), *cases):
        path = folder / f"{key}.pickle"
        if not path.exists():
            path.write_bytes(pickle.dumps(content[key]()))


def answers(
    folder: Path, only: str, steps: Callable[[str], int], there: Iterable[str] = ()
) -> Iterator[tuple[Answer, Naming]]:
    """Yield the present code's answer to each case of the folder that is not ``there``.

    steps : of the naming, by the kind of case
    """
    vehicles = dict[str, Healthy]()
    with threadpool_limits(1):
        for path in sorted(folder.glob("case_*.pickle")):
            if path.stem in set(there) or only not in path.stem:
                continue
            case: Stored = pickle.loads(path.read_bytes())
            if case.vehicle not in vehicles:
                vehicles[case.vehicle] = learned(folder / f"{case.vehicle}.pickle")
            yield _answer(case, vehicles[case.vehicle], steps(case.kind))


def _answer(case: Stored, known: Healthy, steps: int) -> tuple[Answer, Naming]:
    began_s = time.process_time()
    naming = name(case.drives, known, steps=steps)
    took_s = time.process_time() - began_s
    before, without = (_errors(drives, known) for drives in (case.drives, case.sound))
    moved = np.concatenate([a - b for a, b in zip(before, without, strict=True)])
    answer = {
        "key": case.key,
        "kind": case.kind,
        "hidden": case.hidden,
        "size": case.size,
        "gap": float(np.sqrt(np.nanmean(moved**2))),
        "noise": naming.error.floor,
        "verdict": naming.verdict,
        "effects": [each.name for each in naming.answer.effects],
        "labels": [each.label for each in naming.answer.effects],
        "posterior": dict(naming.posterior),
        "beside": [each.name for each in naming.answer.beside],
        "before": naming.error.before,
        "after": naming.error.after,
        "without": float(np.sqrt(np.nanmean(np.concatenate(without) ** 2))),
        "cpu_s": took_s,
    }
    say(f"{case.key}: {naming.verdict} {' '.join(answer['effects'])}, {took_s:.1f} s")
    return answer, naming


def _errors(drives: Sequence[ChainDrive], known: Healthy) -> list[FloatArray]:
    """Return the healthy chain's error over each drive, (n,) in phi, NaN where not scored."""
    found = []
    for drive in map(known.known_of, drives):
        phi = phi_of(drive, known.base) + known.correction(drive)
        found.append(np.where(drive.scored, phi - drive.phi_measured, np.nan))
    return found


def learned(path: Path) -> Healthy:
    """Return what the present code learns of a vehicle, kept beside its drives."""
    code = run_folder.code_sha256()
    kept = path.with_name(f"{path.stem}_{code[:12]}.learned")
    if not kept.exists():
        healthy = yardstick.learn(pickle.loads(path.read_bytes()), Constants())
        kept.write_bytes(pickle.dumps(replace(healthy, surplus=dict(healthy.surplus))))
    learned: Healthy = pickle.loads(kept.read_bytes())
    return learned


def dyno_study(
    first: int, vehicles: int, cases: Sequence[tuple[str, int]], size: Size
) -> plan.Study:
    """Return the plan of simulated vehicles and cases."""
    return plan.Study(
        cases=tuple(cases),
        vehicles=vehicles,
        first_vehicle=first,
        seed=1000 * first,
        drives=DYNO_DRIVES,
        minutes=size.length_s / 60.0,
    )


def dyno_made(study: plan.Study, more: Iterable[plan.Case] = ()) -> Made:
    """Yield the vehicles and the cases of a plan, and further cases."""
    length_s = study.duration_s
    for vehicle in range(study.first_vehicle, study.first_vehicle + study.vehicles):
        parts = plan.healthy_parts(study, vehicle)
        yield (
            f"dyno_{vehicle}",
            lambda v=vehicle, p=parts: plain(map(from_recording, dyno.healthy(p, v, length_s))),
        )
    for case in (*plan.cases(study), *more):
        key = f"case_dyno_{case.kind}_{case.number:03d}_{case.what.replace(' ', '')}"
        yield key, lambda k=key, c=case: _dyno_case(k, c, length_s)


def _dyno_case(key: str, case: plan.Case, length_s: float) -> Stored:
    sound = plain(map(from_recording, dyno.recordings(case, length_s, hidden=False)))
    drives = plain(map(from_recording, dyno.recordings(case, length_s)))
    hidden = tuple(effect for effect, _ in case.hidden)
    size = case.hidden[0][1] if case.hidden else 0.0
    return Stored(key, f"dyno_{case.vehicle}", case.kind, hidden, size, drives, sound)


def plain(drives: Iterable[ChainDrive]) -> list[ChainDrive]:
    """Return the drives as they can be written to a file."""
    return [replace(drive, signals=dict(drive.signals)) for drive in drives]
