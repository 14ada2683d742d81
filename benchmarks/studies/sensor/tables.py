"""Tables of the detection matrix: detection, names, false codes and ROC curves.

A drive counts as detected if any code is set at its end. It counts as named rightly if every code
carries exactly the fault's name.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any, Final

from benchmarks.studies.rules.alarms import OWN, TITLES
from benchmarks.studies.sensor.goals import LIMIT_SEVERITY, at_limit, beyond_limit
from benchmarks.studies.sensor.plan import PLACEMENTS
from benchmarks.studies.sensor.rows import Row
from benchmarks.studies.sensor.severities import ELECTRICAL
from monitor.judge.enable import CONDITIONS
from training.limits.rates import Figures, median, per_1000_h, rate, roc

HEALTHY, NONE, SEVERAL = "healthy", "none", "several names"
MONITOR: Final = "monitor"


def of_kind(rows: Iterable[Row], kind: str) -> list[Row]:
    """Return the rows of one kind: ``healthy``, ``faulty`` or ``reference``."""
    return [r for r in rows if r["kind"] == kind]


def named_rightly(row: Row) -> bool:
    """Return whether the drive's codes carry exactly the name of its fault."""
    return bool(row["faults"] == [row["fault"]])


def figures(rows: Sequence[Row]) -> Figures:
    """Return the rates of detection, right names and completion, and the median times to a code."""
    return {
        "detected": rate(sum(bool(r["codes"]) for r in rows), len(rows)),
        "named": rate(sum(map(named_rightly, rows)), len(rows)),
        "named_or_alike": rate(
            sum(r["fault"] in (*r["faults"], *r["also"]) for r in rows), len(rows)
        ),
        "completed": rate(sum(r["completed"] for r in rows), len(rows)),
        "enabled_s": median([r["first_code_enabled_s"] for r in rows]),
        "driving_s": median([r["first_code_driving_s"] for r in rows]),
    }


def detection(rows: Sequence[Row]) -> list[Figures]:
    """Return ``figures`` for every placement, fault and severity."""
    key = lambda r: (r["placement"], r["fault"], r["severity"])  # noqa: E731
    faulty = sorted(of_kind(rows, "faulty"), key=key)
    return [
        {
            "placement": placement,
            "fault": fault,
            "severity": severity,
            "at_limit": at_limit(fault, severity),
            "beyond_limit": beyond_limit(fault, severity),
            **figures(list(cell)),
        }
        for (placement, fault, severity), cell in groupby(faulty, key)
    ]


def wanted(rows: Sequence[Row], placement: str) -> list[Row]:
    """Return the drives of one placement with a fault at or beyond its limit severity."""
    return [
        r
        for r in of_kind(rows, "faulty")
        if r["placement"] == placement and beyond_limit(r["fault"], r["severity"])
    ]


def by_ambient(rows: Sequence[Row]) -> list[Figures]:
    """Return ``figures`` of the faults at or beyond the limit, for every kind of weather."""
    return [
        {"placement": placement, "ambient": ambient, **figures(cell)}
        for placement in PLACEMENTS
        for ambient, cell in _split(wanted(rows, placement), "ambient")
    ]


def healthy(rows: Sequence[Row]) -> Figures:
    """Return the rates of false codes and completion, and the conditions that blocked judging."""
    good, first = of_kind(rows, "healthy"), of_kind(rows, "reference")
    cells = [
        {"ambient": ambient, "cycle": cycle, **_false(each)}
        for ambient, own in _split(good, "ambient")
        for cycle, each in sorted(_split(own, "cycle"))
    ]
    return {
        "all": _false(good) | {"vehicles": len({r["vehicle"] for r in good})},
        "new": _false([r for r in good if r["aged"] is None]),
        "aged": _false([r for r in good if r["aged"] is not None]),
        "reference": _false(first),
        "cells": cells,
        "not_held": [
            {"ambient": ambient, "enabled": _mean(r["enabled_s"] / r["driving_s"] for r in own)}
            | {name: _mean(r["not_held"][name] for r in own) for name in CONDITIONS}
            | {"windows": _mean(r["windows"] for r in own)}
            for ambient, own in _split(good, "ambient")
        ],
        "codes": [
            {
                k: r[k]
                for k in (
                    "number",
                    "vehicle",
                    "seed",
                    "cycle",
                    "ambient",
                    "aged",
                    "codes",
                    "faults",
                    "first_code_driving_s",
                )
            }
            for r in good
            if r["codes"]
        ],
    }


def confirmed(rows: Sequence[Row]) -> int:
    """Return the number of codes that would be confirmed if vehicles kept their fault memory.

    A code is confirmed if it is set in a drive and in the vehicle's previous drive; drives in which
    no test completed and no code was set are skipped.
    """
    before: dict[int, set[str]] = {}
    count = 0
    for r in sorted(rows, key=lambda r: int(r["number"])):
        codes = set(r["codes"])
        count += len(codes & before.get(r["vehicle"], set()))
        if codes or r["completed"]:
            before[r["vehicle"]] = codes
    return count


def confusion(rows: Sequence[Row], placement: str) -> Figures:
    """Return the confusion matrix of one placement.

    driven : row names, ``healthy`` and the faults at or beyond their limits
    named : column names
    counts : number of drives, one list per row
    several : combinations of names with their number of drives
    """
    chosen = wanted(rows, placement) + [
        r
        for r in of_kind(rows, "faulty")
        if r["placement"] == placement and r["fault"] in ELECTRICAL
    ]
    chosen += of_kind(rows, "healthy")
    counts = Counter((r["fault"] or HEALTHY, _given(r)) for r in chosen)
    several = Counter(
        (r["fault"] or HEALTHY, tuple(r["faults"])) for r in chosen if _given(r) == SEVERAL
    )
    order = [*LIMIT_SEVERITY, *ELECTRICAL]
    driven = [name for name in (HEALTHY, *order) if any(name == fault for fault, _ in counts)]
    given = {name for _, name in counts}
    names = [n for n in (NONE, *order) if n in given or n in driven]
    names += [*sorted(given - set(names) - {SEVERAL}), SEVERAL]
    return {
        "driven": driven,
        "named": names,
        "counts": [[counts[fault, name] for name in names] for fault in driven],
        "several": [
            {"driven": fault, "names": list(given), "drives": count}
            for (fault, given), count in several.most_common()
        ],
    }


def curves(rows: Sequence[Row]) -> list[Figures]:
    """Return the ROC of every rule for every fault at its limit severity.

    The negatives are the healthy drives on the same cycles.
    """
    found = []
    faulty = [r for r in of_kind(rows, "faulty") if at_limit(r["fault"], r["severity"])]
    cycles = {r["cycle"] for r in faulty}
    good = [r for r in of_kind(rows, "healthy") if r["cycle"] in cycles]
    for placement, placed in _split(faulty, "placement"):
        for fault, own in _split(placed, "fault"):
            for rule in TITLES:
                scores = [[r["scores"][rule] for r in each] for each in (good, own)]
                curve = roc(scores[0], scores[1])
                found.append({"placement": placement, "fault": fault, "rule": rule, **curve})
    return found


def side_by_side(rows: Sequence[Row]) -> list[Figures]:
    """Return false alarms and detections of the monitor and of every literature rule."""
    good = of_kind(rows, "healthy")
    found = []
    for rule in (MONITOR, *(name for name in TITLES if name not in OWN)):
        alarms = sum(_alarm_s(r, rule) is not None for r in good)
        figure: Figures = {
            "rule": rule,
            "false_drives": rate(alarms, len(good)),
            "false_1000_h": per_1000_h(alarms, sum(r["driving_s"] for r in good)),
            "false_windows": _windows(good, rule),
        }
        for placement in PLACEMENTS:
            own = wanted(rows, placement)
            times_s = [_alarm_s(r, rule) for r in own]
            figure[placement] = {
                "detected": rate(sum(t is not None for t in times_s), len(own)),
                "windows": _windows(own, rule),
                "enabled_s": median(times_s),
            }
        found.append(figure)
    return found


def _alarm_s(row: Row, rule: str) -> float | None:
    """Return the enabled seconds until the rule's first alarm in a drive, None without one."""
    at: float | None = (
        row["first_code_enabled_s"] if rule == MONITOR else row["alarms_enabled_s"][rule]
    )
    return at


def _windows(rows: Sequence[Row], rule: str) -> Figures:
    return rate(sum(r["failed_windows"][rule] for r in rows), sum(r["windows"] for r in rows))


def _false(rows: Sequence[Row]) -> Figures:
    events = sum(bool(r["codes"]) for r in rows)
    wltc = [r for r in rows if r["cycle"] == "wltc_3b"]
    return {
        "false": rate(events, len(rows)),
        "false_1000_h": per_1000_h(events, sum(r["driving_s"] for r in rows)),
        "confirmed": confirmed(rows),
        "completed": rate(sum(r["completed"] for r in rows), len(rows)),
        "completed_wltc": rate(sum(r["completed"] for r in wltc), len(wltc)),
    }


def _given(row: Row) -> str:
    names = row["faults"]
    return NONE if not names else str(names[0]) if len(names) == 1 else SEVERAL


def _split(rows: Iterable[Row], key: str) -> list[tuple[Any, list[Row]]]:
    """Return pairs of value and rows for the values of ``key``, in order of first occurrence."""
    found: dict[Any, list[Row]] = {}
    for r in rows:
        found.setdefault(r[key], []).append(r)
    return list(found.items())


def _mean(values: Iterable[float]) -> float | None:
    every = list(values)
    return sum(every) / len(every) if every else None
