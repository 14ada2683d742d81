"""Marks for an answer of the gap workflow: right, in the ambiguous set, wrong; size of the gap."""

from collections.abc import Iterable
from typing import Final

from benchmarks.studies.tables import AND, Row
from training.greybox.effects import LIBRARY

CLASSES: Final = ("below the noise", "1 to 2 times the noise", "at least twice the noise")
SUSPECTED: Final = "sensor_fault_suspected"
AMONG: Final = "ambiguous, it among them"
ERROR: Final = "error"


def done(rows: Iterable[Row], kind: str | None = None) -> list[Row]:
    """Return the rows without an error; ``kind`` keeps one kind of cases, None keeps all."""
    return [r for r in rows if r["error"] is None and kind in (None, r["kind"])]


def size(row: Row) -> str:
    """Return the class of a case's measured gap.

    >>> size({"gap_over_noise": 1.5})
    '1 to 2 times the noise'
    """
    over = row["gap_over_noise"]
    return CLASSES[2 if over >= 2.0 else 1 if over >= 1.0 else 0]


def large(rows: Iterable[Row]) -> list[Row]:
    """Return the cases whose gap is at least twice the noise."""
    return [r for r in rows if size(r) == CLASSES[2]]


def errs(row: Row) -> bool:
    """Return whether the base model's excess error is at least twice the noise.

    A base model fitted to drives with the hidden effect may already follow part of the effect.

    >>> errs({"excess_before": 4e-4, "noise": 0.01}), errs({"excess_before": -1e-5, "noise": 0.01})
    (True, False)
    """
    return bool(row["excess_before"] >= (2.0 * row["noise"]) ** 2)


def alike(hidden: str, answered: str) -> bool:
    """Return whether the answered name counts as the hidden one: the same name or gain class.

    >>> alike("ethanol", "ethanol"), alike("purge", "ethanol")
    (True, False)
    """
    if hidden == answered:
        return True
    a, b = LIBRARY.get(hidden), LIBRARY.get(answered)
    if a is None or b is None:
        return False
    return (a.gain_class and b.gain_class) or hidden in b.like or answered in a.like


def right(row: Row) -> bool:
    """Return whether the answer names every hidden effect and no other."""
    return (
        bool(row["names"])
        and not wrong_names(row)
        and all(any(alike(hidden, name) for name in row["names"]) for hidden in row["hidden"])
    )


def right_or_among(row: Row) -> bool:
    """Return whether the name is right, or the hidden effect stands in the ambiguous set."""
    return right(row) or any(alike(h, n) for h in row["hidden"] for n in row["among"])


def right_or_beside_fault(row: Row) -> bool:
    """Return whether an answer is right, among, or lists the effect as like a suspected fault."""
    like = row["indistinguishable"]
    return right_or_among(row) or any(alike(h, n) for h in row["hidden"] for n in like)


def wrong_names(row: Row) -> list[str]:
    """Return the answered names that match no hidden effect."""
    return [n for n in row["names"] if not any(alike(h, n) for h in row["hidden"])]


def answer(row: Row) -> str:
    """Return the names or the verdict of an answer."""
    if row["error"] is not None:
        return ERROR
    if row["verdict"] == "ambiguous" and right_or_among(row):
        return AMONG
    return AND.join(row["names"]) if row["verdict"] == "named" else str(row["verdict"])


def hidden(row: Row) -> str:
    """Return what a case hides, as one name."""
    names = {
        "null": "nothing",
        "two": "two effects",
        "onset": f"onset: {row['fault']}",
        "fault": f"from the start: {row['fault']}",
    }
    return names.get(row["kind"]) or str(row["hidden"][0])


def closed(row: Row) -> float | None:
    """Return the share of the excess error that the new model removes, 0 without a new model.

    Return None if the old model had no excess error.
    """
    if row["excess_before"] <= 0.0:
        return None
    return float(1.0 - row["excess_after"] / row["excess_before"])
