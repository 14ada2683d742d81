"""Naming on stored cases: drives are simulated once, any version of the code answers them.

Cases come from the dynamometer of the gap study, from the second engine, whose equations are
others, and from vehicles of the second engine in which every effect has another form. The set
``choose`` is for setting numbers, ``report`` holds other vehicles and seeds, ``apart`` further ones
of the second engine and its variants alone. Drives last five minutes, four (dynamometer) or six
(second engine) per case, eight healthy ones. Missing cases are made first, an hour or so.

python -m benchmarks gap_naming [--folder build/gap_cases] [--set report] [--only TEXT]
    [--answers FILE]

``--answers`` goes on with the answers of a file, one JSON per line.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import cycle, islice
from pathlib import Path
from typing import Final

from benchmarks.gap_cases import second_engine_cases, stored
from benchmarks.gap_cases.answers import LIKE_SENSOR, Answer, figures
from benchmarks.gap_cases.stored import SMALLEST, WHOLE, Made, Size, Stored, plain
from benchmarks.outcome import BenchmarkOptions, finish
from benchmarks.studies.second.engine import FORM, SOUND, Form
from benchmarks.studies.second.engine import drive as second_drive
from benchmarks.studies.workflow import plan
from training.greybox.fit.drive import ChainDrive

DRIVES: Final = WHOLE.case  # also the fewest in which speeds and loads come twice
HALF: Final = 0.5  # of the second engine's sizes, in its second vehicle of each set
KINDS: Final = ("effect", "null", "unknown", "two", "onset", "fault")
STUDIES: Final = {  # first vehicle, vehicles; cases by kind
    "choose": ((52_000, 4), (48, 16, 18, 18, 10, 10)),
    "report": ((54_000, 4), (48, 30, 18, 18, 12, 12)),
}
SECOND: Final = {"choose": (31, 32), "report": (51, 52), "apart": (61, 62)}
# Engines of the second one's structure in which every effect has a form of its own.
OTHERS: Final = {"choose": (131, 132), "report": (151, 152), "apart": (161, 162)}
BESIDE: Final = 12  # cases with an effect of one of the larger sizes beside a fault from the start
LARGER: Final = 3  # index into the sizes of an effect
STEPS: Final = {"two": 2, "beside": 2}  # of the naming, by kind; 1 for the others
ONE_CASE: Final = "case_second_31_effect_006"  # of the set choose


def main(argv: Sequence[str]) -> int:
    """Make the cases that are missing, answer them and count."""
    options = BenchmarkOptions(__name__, __doc__, set="choose", only=ONE_CASE, folder=None)
    options.add_argument("--folder", type=Path, default=Path("build/gap_cases"))
    options.add_argument("--set", choices=tuple(SECOND), default="choose")
    options.add_argument("--only", default="", help="part of the keys of the cases")
    options.add_argument("--answers", type=Path, metavar="FILE")
    args = options.parse_args(argv)
    with stored.place(args.folder) as place:
        folder = place / args.set
        stored.make(folder, made(args.set, SMALLEST if args.smallest else WHOLE), args.only)
        found: list[Answer] = []
        if args.answers and args.answers.exists():
            found += map(json.loads, args.answers.read_text().splitlines())
        there = [each["key"] for each in found]
        for answer, _ in stored.answers(folder, args.only, lambda k: STEPS.get(k, 1), there):
            found.append(answer)
            if args.answers:
                with args.answers.open("a") as file:
                    file.write(json.dumps(answer) + "\n")
    return finish(args, list(figures(found)))


def made(set_: str, size: Size) -> Made:
    """Yield the vehicles and cases of a set."""
    if set_ in STUDIES:
        (first, vehicles), numbers = STUDIES[set_]
        study = stored.dyno_study(first, vehicles, list(zip(KINDS, numbers, strict=True)), size)
        yield from stored.dyno_made(study, _beside(study))
    yield from _of_second_engine("second", SECOND[set_], size)
    yield from _of_second_engine("other", OTHERS[set_], size)


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


def _of_second_engine(engine: str, vehicles: Sequence[int], size: Size) -> Made:
    for place, vehicle in enumerate(vehicles):
        yield (
            f"{engine}_{vehicle}",
            lambda v=vehicle: plain(
                second_drive(v, 1000 * v + i, length_s=size.length_s, form=_form(v))
                for i in range(size.healthy)
            ),
        )
        for number, case in enumerate(second_engine_cases.cases()):
            what = case.what.replace(" ", "_")
            key = f"case_{engine}_{vehicle}_{case.kind}_{number:03d}_{what}"
            sized = case._replace(size=case.size * (HALF if place % 2 else 1.0))
            yield key, partial(_case, key, vehicle, number, sized, size.length_s)


def _case(
    key: str, vehicle: int, number: int, case: second_engine_cases.EngineCase, length_s: float
) -> Stored:
    def driven(hidden: Mapping[str, float], *, faulty: bool) -> list[ChainDrive]:
        drives = []
        for i in range(DRIVES):
            sensor = case.sensor if faulty and i >= case.from_drive else SOUND
            if case.from_drive and i == case.from_drive and faulty:
                sensor = sensor._replace(start_s=length_s / 2.0)
            seed = 1000 * vehicle + 100 + 10 * number + i
            drives.append(second_drive(vehicle, seed, hidden, sensor, length_s, _form(vehicle)))
        return plain(drives)

    hidden = {case.what: case.size} if case.size else {}
    return Stored(
        key=key,
        vehicle="_".join(key.split("_")[1:3]),
        kind=case.kind,
        hidden=tuple(hidden),
        size=case.size,
        drives=driven(hidden, faulty=True),
        sound=driven({}, faulty=False),
    )


def _form(vehicle: int) -> Form:
    """Return the form of the effects of a vehicle, from its number."""
    return FORM if vehicle < min(OTHERS["choose"]) else Form.of(vehicle)
