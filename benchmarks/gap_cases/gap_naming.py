"""Naming on stored cases: drives are simulated once, any version of the code answers them.

Cases come from the dynamometer of the gap study, from the second engine, whose equations are
others, and from vehicles of the second engine in which every effect has another form. The set
``choose`` is for setting numbers, ``report`` holds other vehicles and seeds, ``apart`` further ones
of the second engine and its variants alone. Drives last five minutes, four (dynamometer) or six
(second engine) per case, eight healthy ones.

    python -m benchmarks gap_naming make FOLDER
    python -m benchmarks gap_naming answer FOLDER --set report --out answers.jsonl
    python -m benchmarks gap_naming table answers.jsonl [other.jsonl ...]
"""

import argparse
import json
import pickle
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import cycle, islice
from pathlib import Path
from typing import Any, Final

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.gap_cases import gap_second_engine
from benchmarks.gap_cases.gap_naming_table import LIKE_SENSOR, table
from benchmarks.studies.second.engine import FORM, SOUND, Form
from benchmarks.studies.second.engine import drive as second_drive
from benchmarks.studies.workflow import drive as dyno
from benchmarks.studies.workflow import plan
from training.gap.healthy.behaviour import Healthy
from training.gap.name import yardstick
from training.gap.name.naming import name
from training.greybox.chain import Constants, simulate
from training.greybox.fit.drive import Drive, from_recording, path_of
from training.jobs import run_folder

ROOT: Final = Path(__file__).parents[1]
LENGTH_S: Final = 300.0
DYNO_DRIVES: Final = 4
HEALTHY_DRIVES: Final = 8
HALF: Final = 0.5  # of the second engine's sizes, in its second vehicle of each set
STUDIES: Final = {
    "choose": ((52_000, 4), (48, 16, 18, 18, 10, 10)),  # first vehicle, vehicles; cases by kind
    "report": ((54_000, 4), (48, 30, 18, 18, 12, 12)),
}
SECOND: Final = {"choose": (31, 32), "report": (51, 52), "apart": (61, 62)}
# Engines of the second one's structure in which every effect has a form of its own.
OTHERS: Final = {"choose": (131, 132), "report": (151, 152), "apart": (161, 162)}
KINDS: Final = ("effect", "null", "unknown", "two", "onset", "fault")
BESIDE: Final = 12  # cases with an effect of one of the larger sizes beside a fault from the start
LARGER: Final = 3  # index into the sizes of an effect
STEPS: Final = {"two": 2, "beside": 2}  # of the naming, by kind; 1 for the others
OF_SECOND: Final = {
    "nothing": "null",
    "effect": "effect",
    "fault from the start": "fault",
    "fault with an onset": "onset",
}


@dataclass(frozen=True, slots=True)
class Stored:
    """One case as it lies on the disk."""

    key: str
    vehicle: str
    kind: str
    hidden: tuple[str, ...]
    size: float
    drives: list[Drive]
    sound: list[Drive]  # the same drives with nothing hidden


def main(argv: Sequence[str]) -> int:
    """Make cases, answer them, or print the table of answers."""
    parser = argparse.ArgumentParser(description=__doc__)
    parts = parser.add_subparsers(dest="part", required=True)
    making = parts.add_parser("make")
    making.add_argument("folder", type=Path)
    making.add_argument("--only", default="", help="part of the keys to make")
    answering = parts.add_parser("answer")
    answering.add_argument("folder", type=Path)
    answering.add_argument("--set", choices=tuple(SECOND), default="choose")
    answering.add_argument("--out", type=Path, required=True)
    answering.add_argument("--only", default="", help="part of the keys of the cases to answer")
    showing = parts.add_parser("table")
    showing.add_argument("answers", type=Path, nargs="+")
    args = parser.parse_args(argv)
    if args.part == "make":
        make(args.folder, args.only)
    elif args.part == "answer":
        with threadpool_limits(1):
            answer(args.folder / args.set, args.out, args.only)
    else:
        print(table(args.answers))
    return 0


def make(folder: Path, only: str) -> None:
    """Simulate all vehicles and cases that the folder lacks."""
    for set_ in SECOND:
        to = folder / set_
        to.mkdir(parents=True, exist_ok=True)
        for key, simulated in (
            *(_of_dyno(set_) if set_ in STUDIES else ()),
            *_of_second_engine(set_, SECOND),
            *_of_second_engine(set_, OTHERS),
        ):
            path = to / f"{key}.pickle"
            if only in key and not path.exists():
                path.write_bytes(pickle.dumps(simulated()))


def answer(folder: Path, out: Path, only: str) -> None:
    """Write one line of JSON per case that ``out`` lacks."""
    lines = out.read_text().splitlines() if out.exists() else []
    there = {json.loads(line)["key"] for line in lines}
    vehicles = dict[str, Healthy]()
    for path in sorted(folder.glob("case_*.pickle")):
        if path.stem in there or only not in path.stem:
            continue
        case: Stored = pickle.loads(path.read_bytes())
        if case.vehicle not in vehicles:
            vehicles[case.vehicle] = _learned(folder / f"{case.vehicle}.pickle")
        with out.open("a") as file:
            file.write(json.dumps(_row(case, vehicles[case.vehicle])) + "\n")


def _row(case: Stored, known: Healthy) -> dict[str, Any]:
    began_s = time.process_time()
    naming = name(case.drives, known, steps=STEPS.get(case.kind, 1))
    took_s = time.process_time() - began_s
    merits = [
        {"name": c.name}
        | {k: getattr(c.merit, k) for k in ("score", "needed", "t", "adequacy", "physical", "win")}
        for c in naming.trials.ranking[:6]
    ]
    before, without = _errors(case.drives, known), _errors(case.sound, known)
    moved = np.concatenate([a - b for a, b in zip(before, without, strict=True)])
    return {
        "key": case.key,
        "kind": case.kind,
        "hidden": case.hidden,
        "size": case.size,
        "gap": float(np.sqrt(np.nanmean(moved**2))),
        "noise": naming.error.floor,
        "verdict": naming.verdict,
        "effects": [each.name for each in naming.answer.effects],
        "suspected": naming.answer.suspected,
        "beside": [each.name for each in getattr(naming.answer, "beside", ())],
        "posterior": dict(getattr(naming, "posterior", None) or {}),
        "ranking": merits,
        "before": naming.error.before,
        "after": naming.error.after,
        "without": float(np.sqrt(np.nanmean(np.concatenate(without) ** 2))),
        "cpu_s": took_s,
    }


def _errors(drives: Sequence[Drive], known: Healthy) -> list[Any]:
    """Return the healthy chain's error over each drive, (n,) in phi, NaN where not scored."""
    found = []
    for drive in map(known.known_of, drives):
        phi = simulate(path_of(drive, known.base), drive.period_s) + known.correction(drive)
        found.append(np.where(drive.scored, phi - drive.phi_measured, np.nan))
    return found


def _learned(path: Path) -> Healthy:
    """Return what the present code learns of a vehicle, kept beside its drives."""
    code = run_folder.code_sha256()
    kept = path.with_name(f"{path.stem}_{code[:12]}.learned")
    if not kept.exists():
        healthy = yardstick.learn(pickle.loads(path.read_bytes()), Constants())
        kept.write_bytes(pickle.dumps(replace(healthy, surplus=dict(healthy.surplus))))
    learned: Healthy = pickle.loads(kept.read_bytes())
    return learned


Made = Iterator[tuple[str, Callable[[], Any]]]


def _of_dyno(set_: str) -> Made:
    (first, vehicles), numbers = STUDIES[set_]
    study = plan.Study(
        cases=tuple(zip(KINDS, numbers, strict=True)),
        vehicles=vehicles,
        first_vehicle=first,
        seed=1000 * first,
        drives=DYNO_DRIVES,
        duration_s=LENGTH_S,
    )
    for vehicle in range(first, first + vehicles):
        parts = plan.healthy_parts(study, vehicle)
        yield (
            f"dyno_{vehicle}",
            lambda v=vehicle, p=parts: _plain(map(from_recording, dyno.healthy(p, v, LENGTH_S))),
        )
    for case in (*plan.cases(study), *_beside(study)):
        key = f"case_dyno_{case.kind}_{case.number:03d}_{case.what.replace(' ', '')}"
        yield key, lambda k=key, c=case: _dyno_case(k, c)


def _beside(study: plan.Study) -> Iterator[plan.Case]:
    """Yield effects with a fault of the sensor from the start beside them."""
    every = plan.cases(study)
    faults = cycle(case.fault for case in every if case.kind == "fault")
    large = (c for c in every if c.kind == "effect" and _is_large(*c.hidden[0]))
    for case in islice(large, BESIDE):
        parts = tuple(replace(part, fault_start_s=0.0) for part in case.parts)
        yield replace(case, kind="beside", fault=next(faults), parts=parts)


def _is_large(effect: str, severity: float) -> bool:
    return effect not in LIKE_SENSOR and severity >= plan.SEVERITIES[effect][LARGER]


def _dyno_case(key: str, case: plan.Case) -> Stored:
    sound = _plain(map(from_recording, dyno.recordings(case, LENGTH_S, hidden=False)))
    drives = _plain(map(from_recording, dyno.recordings(case, LENGTH_S)))
    hidden = tuple(effect for effect, _ in case.hidden)
    size = case.hidden[0][1] if case.hidden else 0.0
    return Stored(key, f"dyno_{case.vehicle}", case.kind, hidden, size, drives, sound)


def _of_second_engine(set_: str, vehicles: Mapping[str, Sequence[int]]) -> Made:
    engine = "second" if vehicles is SECOND else "other"
    for place, vehicle in enumerate(vehicles[set_]):
        yield (
            f"{engine}_{vehicle}",
            lambda v=vehicle: _plain(
                second_drive(v, 1000 * v + i, length_s=LENGTH_S, form=_form(v))
                for i in range(HEALTHY_DRIVES)
            ),
        )
        for number, case in enumerate(gap_second_engine.cases()):
            kind = OF_SECOND[case.kind]
            what = case.what.replace(" ", "_")
            key = f"case_{engine}_{vehicle}_{kind}_{number:03d}_{what}"
            size = case.size * (HALF if place % 2 else 1.0)
            sized = case._replace(size=size)
            yield key, lambda k=key, v=vehicle, n=number, c=sized: _second_case(engine, k, v, n, c)


def _second_case(
    engine: str, key: str, vehicle: int, number: int, case: gap_second_engine.Case
) -> Stored:
    def driven(hidden: Mapping[str, float], *, faulty: bool) -> list[Drive]:
        made = []
        for i in range(gap_second_engine.DRIVES):
            sensor = case.sensor if faulty and i >= case.from_drive else SOUND
            if case.from_drive and i == case.from_drive and faulty:
                sensor = sensor._replace(start_s=LENGTH_S / 2.0)
            seed = 1000 * vehicle + 100 + 10 * number + i
            made.append(second_drive(vehicle, seed, hidden, sensor, LENGTH_S, _form(vehicle)))
        return _plain(made)

    hidden = {case.what: case.size} if case.size else {}
    return Stored(
        key=key,
        vehicle=f"{engine}_{vehicle}",
        kind=OF_SECOND[case.kind],
        hidden=tuple(hidden),
        size=case.size,
        drives=driven(hidden, faulty=True),
        sound=driven({}, faulty=False),
    )


def _form(vehicle: int) -> Form:
    """Return the form of the effects of a vehicle, from its number."""
    return FORM if vehicle < min(OTHERS["choose"]) else Form.of(vehicle)


def _plain(drives: Any) -> list[Drive]:
    """Return the drives as they can be written to a file."""
    return [replace(drive, signals=dict(drive.signals)) for drive in drives]
