"""Tables of the gap study: confusion matrix, rates by effect and gap size, wrong names."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from benchmarks.studies.workflow.answers import (
    AMONG,
    CLASSES,
    ERROR,
    SEVERAL,
    SUSPECTED,
    answer,
    done,
    hidden,
    right,
    right_or_among,
    size,
    wrong_names,
)
from benchmarks.studies.workflow.case import Row
from benchmarks.studies.workflow.plan import UNKNOWN
from training.greybox.effects import LIBRARY

FIRST: Final = ("no_gap",)
LAST: Final = (AMONG, "ambiguous", "unknown_effect", SUSPECTED, SEVERAL, ERROR)


@dataclass(frozen=True, slots=True)
class Cell:
    """Counts over the cases of one effect and one class of the gap."""

    effect: str
    size: str
    cases: int
    right: int
    among: int  # right name, or the hidden effect in the ambiguous set
    wrong: int
    verdicts: str  # verdicts other than ``named`` with their counts, as text


def confusion(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the confusion matrix.

    driven : row names, the hidden effects and faults
    named : column names, the answers
    counts : number of cases, one list per row
    """
    counts = Counter((hidden(r), answer(r)) for r in rows)
    order = ["nothing", *LIBRARY, *UNKNOWN, "two effects"]
    there = {what for what, _ in counts}
    driven = [what for what in order if what in there]
    driven += sorted(there - set(driven))
    given = {what for _, what in counts}
    named = [*FIRST, *LIBRARY, *(each for each in LAST if each in given)]
    return {
        "driven": driven,
        "named": named,
        "counts": [[counts[what, name] for name in named] for what in driven],
    }


def by_size(rows: Sequence[Row]) -> list[Cell]:
    """Return a cell for every effect and class of the gap, then cells for all effects together."""
    effect = done(rows, "effect")
    found = []
    for name in (*LIBRARY, None):
        for each in reversed(CLASSES):
            own = [r for r in effect if size(r) == each and name in (None, r["hidden"][0])]
            if own:
                found.append(_cell(name or "all effects", each, own))
    return found


def wrong(rows: Sequence[Row]) -> list[Row]:
    """Return the rows with at least one wrong name."""
    return [r for r in done(rows) if wrong_names(r)]


def two(rows: Sequence[Row]) -> dict[str, int]:
    """Return the number of cases with two hidden effects by result; empty without such cases."""
    own = done(rows, "two")
    found = Counter(_of_two(r) for r in own)
    order = ("both right", "one right, nothing wrong", "a wrong name")
    return {each: found[each] for each in (*order, *sorted(set(found) - set(order)))} if own else {}


def _of_two(row: Row) -> str:
    if wrong_names(row):
        return "a wrong name"
    if right(row):
        return "both right"
    return "one right, nothing wrong" if row["names"] else str(row["verdict"])


def _cell(effect: str, size_: str, rows: Sequence[Row]) -> Cell:
    bad = [r for r in rows if wrong_names(r)]
    others = Counter(r["verdict"] for r in rows if r["verdict"] != "named")
    return Cell(
        effect=effect,
        size=size_,
        cases=len(rows),
        right=sum(map(right, rows)),
        among=sum(map(right_or_among, rows)),
        wrong=len(bad),
        verdicts=", ".join(f"{n} {verdict}" for verdict, n in others.most_common()),
    )
