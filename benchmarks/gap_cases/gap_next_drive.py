"""The next drive: how often the naming is right after the manoeuvre that it proposed.

Vehicles of the second engine with an effect so small, or drives so short, that the naming does not
say one name. Each then drives ten minutes of the proposed manoeuvre, and ten minutes at random. A
drive like a present one is another at random.

python -m benchmarks gap_next_drive [--folder build/gap_cases] [--set report] [--most 20]
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, Final

from threadpoolctl import threadpool_limits

from benchmarks.gap_cases import stored
from benchmarks.gap_cases.answers import share
from benchmarks.gap_cases.second_engine_cases import SIZES
from benchmarks.gap_cases.stored import plain
from benchmarks.outcome import BenchmarkOptions, Row, finish, say
from benchmarks.studies.second.engine import drive as second_drive
from training.gap.name.manoeuvres import LONG_S, library
from training.gap.name.naming import name
from training.gap.name.verdict import Naming
from training.greybox.fit.drive import ChainDrive

VEHICLES: Final = {"choose": (31, 32), "report": (73, 74)}
SMALL: Final = (0.3, 0.5)  # of the sizes of the other cases
DRIVES: Final = 2
LENGTH_S: Final = 240.0
HEALTHY: Final = 8
Driven = Callable[..., ChainDrive]  # seed, length_s, course


def main(argv: Sequence[str]) -> int:
    """Look for undecided cases, drive on, and count."""
    options = BenchmarkOptions(__name__, __doc__, set="choose", most=1, folder=None)
    options.add_argument("--folder", type=Path, default=Path("build/gap_cases"))
    options.add_argument("--set", choices=tuple(VEHICLES), default="choose")
    options.add_argument("--most", type=int, default=20, help="undecided cases")
    args = options.parse_args(argv)
    rows: list[dict[str, Any]] = []
    with stored.place(args.folder) as place, threadpool_limits(1):
        for row in _rows(place / args.set, VEHICLES[args.set]):
            rows.append(row)
            say(str(row))
            if len(rows) == args.most:
                break
    asked = [row for row in rows if row["expected"] is not None]
    shares: list[Row] = [
        share(f"{words} after {drive}", sum(row[drive] in which for row in asked), len(asked))
        for words, which in (("named right", ("right",)), ("right or likeliest", GOOD))
        for drive in ("proposed", "random")
        if asked
    ]
    return finish(args, [*rows, *shares])


GOOD: Final = ("right", "likeliest")


def _rows(folder: Path, vehicles: Sequence[int]) -> Iterator[dict[str, Any]]:
    folder.mkdir(parents=True, exist_ok=True)
    for vehicle, size, (number, effect) in product(vehicles, SMALL, enumerate(SIZES)):
        path = folder / f"second_{vehicle}.pickle"
        if not path.exists():
            seeds = range(1000 * vehicle, 1000 * vehicle + HEALTHY)
            stored.keep(path, plain(second_drive(vehicle, s, length_s=300.0) for s in seeds))
        known = stored.learned(path)

        def driven(
            seed: int,
            length_s: float = LENGTH_S,
            course: ChainDrive | None = None,
            of: tuple[int, str, float] = (vehicle, effect, size),
        ) -> ChainDrive:
            own, what, part = of
            hidden = {what: part * SIZES[what]}
            return second_drive(own, seed, hidden, length_s=length_s, course=course)

        seed = 1000 * vehicle + 500 + 10 * number
        drives = [replace(driven(seed + i), name=f"drive {i}") for i in range(DRIVES)]
        first = name(drives, known)
        if first.verdict not in ("ambiguous", "unknown_effect") or first.answer.experiment is None:
            continue
        proposed = first.answer.experiment
        course = library(drives[0].period_s).get(proposed.name)
        more = {"proposed": driven(seed + 8, LONG_S, course), "random": driven(seed + 9, LONG_S)}
        answers = {words: _answer(name([*drives, d], known), effect) for words, d in more.items()}
        yield {
            "case": f"{vehicle} {size:g} {effect}",
            "at first": _answer(first, effect),
            "manoeuvre": proposed.name,
            "expected": proposed.right,
            **answers,
        }


def _answer(naming: Naming, effect: str) -> str:
    """Return whether the name is right, or the likeliest hypothesis, else the verdict."""
    if naming.verdict == "named":
        return "right" if [c.name for c in naming.answer.effects] == [effect] else "wrong"
    likeliest = max(naming.posterior, key=lambda each: naming.posterior[each])
    return "likeliest" if likeliest == effect else naming.verdict
