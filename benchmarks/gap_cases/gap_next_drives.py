"""The next drives: how often does the naming say the right name after the driving it proposed?

Vehicles of the second engine in which every effect has another form than in the library, with an
effect so small and drives so short that the naming says several names. Each then drives as long as
proposed, at random as before.

python -m benchmarks gap_next_drives [--folder build/gap_next_drives] [--vehicles 8]
"""

import pickle
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.gap_cases import stored
from benchmarks.gap_cases.answers import share
from benchmarks.gap_cases.second_engine_cases import SIZES
from benchmarks.gap_cases.stored import plain
from benchmarks.outcome import BenchmarkOptions, finish, say
from benchmarks.studies.second.engine import Form, drive
from monitor.base.errors import RecordingError
from training.gap.name.naming import name
from training.gap.name.verdict import Naming
from training.greybox.fit.drive import ChainDrive
from training.healthy.behaviour import Healthy

SMALL: Final = (0.5, 0.3)  # of the sizes of the other cases
EFFECTS: Final = tuple(SIZES)
HEALTHY_S: Final = 300.0
DRIVES: Final = 2
MORE: Final = 4  # recordings of the proposed driving


def main(argv: Sequence[str]) -> int:
    """Look for ambiguous cases, drive on, and count."""
    few = {"first": 143, "vehicles": 1, "healthy": 3, "effects": ["maf_offset"], "seconds": 120.0}
    options = BenchmarkOptions(__name__, __doc__, **few, folder=None)
    options.add_argument("--folder", type=Path, default=Path("build/gap_next_drives"))
    options.add_argument("--first", type=int, default=141, help="vehicle")
    options.add_argument("--vehicles", type=int, default=8)
    options.add_argument("--healthy", type=int, default=8, help="drives of each vehicle")
    options.add_argument("--seconds", type=float, default=240.0, help="of a drive with an effect")
    options.add_argument("--effects", nargs="+", choices=EFFECTS, default=EFFECTS)
    args = options.parse_args(argv)
    rows: list[dict[str, Any]] = []
    with stored.place(args.folder) as folder, threadpool_limits(1):
        folder.mkdir(parents=True, exist_ok=True)
        for vehicle in range(args.first, args.first + args.vehicles):
            known = _known(folder, vehicle, args.healthy)
            for row in _rows(vehicle, known, args.effects, args.seconds):
                rows.append(row)
                say(str(row))
    if not rows:
        return finish(args, [{"figure": "ambiguous cases", "n": 0}])
    counted = [
        share(
            f"{after} after the proposed driving", sum(r["after"] == after for r in rows), len(rows)
        )
        for after in ("right", "wrong")
    ]
    told = {"figure": "mean probability told", "%": 100 * np.mean([r["told"] for r in rows])}
    return finish(args, [*rows, *counted, told])


def _known(folder: Path, vehicle: int, n: int) -> Healthy:
    """Return what is learned of a vehicle's healthy drives, made if the folder has none."""
    path = folder / f"other_{vehicle}.pickle"
    if not path.exists():
        path.write_bytes(pickle.dumps([_drive(vehicle, i, HEALTHY_S) for i in range(n)]))
    return stored.learned(path)


def _drive(vehicle: int, number: int, length_s: float, **hidden: float) -> ChainDrive:
    """Return a drive with the vehicle's own form of a hidden effect."""
    seed, form = 1000 * vehicle + number, Form.of(vehicle)
    return plain([drive(vehicle, seed, hidden, length_s=length_s, form=form)])[0]


def _rows(
    vehicle: int, known: Healthy, effects: Sequence[str], first_s: float
) -> Iterator[dict[str, Any]]:
    for size, effect in product(SMALL, effects):
        hidden = {effect: size * SIZES[effect]}
        first = 100 + 20 * EFFECTS.index(effect)
        drives = [_drive(vehicle, first + i, first_s, **hidden) for i in range(DRIVES)]
        try:
            naming = name(drives, known)
        except RecordingError:  # of driving that the healthy drives do not know
            continue
        more = naming.answer.experiment
        if naming.verdict != "ambiguous" or more is None:
            continue
        length_s = float(round(more.seconds / MORE))
        numbers = range(first + DRIVES, first + DRIVES + MORE)
        drives += [_drive(vehicle, i, length_s, **hidden) for i in numbers]
        yield {
            "case": f"{vehicle} {size:g} {effect}",
            "first": more.name,
            "told": more.probability,
            "minutes": more.seconds / 60.0,
            "after": _answer(name(drives, known), effect),
        }


def _answer(naming: Naming, effect: str) -> str:
    """Return whether the name is right or wrong, else the verdict."""
    if naming.verdict != "named":
        return naming.verdict
    return "right" if [c.name for c in naming.answer.effects] == [effect] else "wrong"
