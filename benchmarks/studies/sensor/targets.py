"""Targets of the detection matrix: the wanted and the measured figure, with 95 % bounds.

A target is met if the measured figure reaches the wanted one. It is proved if the worse of the two
95 % bounds reaches it, too.
"""

from collections.abc import Sequence

from benchmarks.studies.sensor import tables
from benchmarks.studies.sensor.goals import (
    COMPLETED,
    DETECTED,
    HEALTHY_DRIVES,
    HEALTHY_VEHICLES,
    MEDIAN_ENABLED_S,
    NAMED,
    at_limit,
)
from benchmarks.studies.sensor.rows import Row
from training.limits.rates import Figures, rate

PLACES = {"loop": "fault in the loop", "after": "fault put on afterwards"}


def assess(rows: Sequence[Row]) -> list[Figures]:
    """Return the targets in the order of the report.

    The keys of a target are ``what``, ``where``, ``wanted``, ``found``, ``low``, ``high``,
    ``trials``, ``unit``, ``met`` and ``proved`` (None with too few drives), ``missed_by`` and
    ``why``, the reason why the target is not judged.
    """
    found = []
    for placement, place in PLACES.items():
        every = tables.wanted(rows, placement)
        limit = [r for r in every if at_limit(r["fault"], r["severity"])]
        for own, scope in ((limit, "at the limit"), (every, "at or beyond the limit")):
            found += of_faults(tables.figures(own), f"{place}, {scope}")
    return found + _healthy(tables.healthy(rows)["all"])


def of_faults(figures: Figures, where: str) -> list[Figures]:
    """Return the targets of a group of faulty drives with the measured ``figures``."""
    return [
        _share("detected within one drive", where, DETECTED, figures["detected"]),
        _share("named rightly", where, NAMED, figures["named"]),
        _time("median enabled time to the code", where, figures["enabled_s"]),
    ]


def _share(what: str, where: str, wanted: float, share: Figures) -> Figures:
    """Return the target that ``share`` is at least ``wanted``."""
    found, low = share["rate"], share["low"]
    return {
        "what": what,
        "where": where,
        "unit": "share",
        "wanted": wanted,
        "found": found,
        "low": low,
        "high": share["high"],
        "trials": share["trials"],
        "met": None if found is None else found >= wanted,
        "proved": None if low is None else low >= wanted,
        "missed_by": None if found is None else max(wanted - found, 0.0),
        "why": "" if share["trials"] else "no such drive",
    }


def _time(what: str, where: str, times: Figures) -> Figures:
    """Return the target of the median time in seconds; a time of None means never."""
    found, high, none = times["median"], times["high"], times["trials"] == 0
    met = found is not None and found <= MEDIAN_ENABLED_S
    return {
        "what": what,
        "where": where,
        "unit": "s",
        "wanted": MEDIAN_ENABLED_S,
        "found": found,
        "low": times["low"],
        "high": high,
        "trials": times["trials"],
        "met": None if none else met,
        "proved": None if none else high is not None and high <= MEDIAN_ENABLED_S,
        "missed_by": None if found is None else max(found - MEDIAN_ENABLED_S, 0.0),
        "why": "no such drive" if none else "",
    }


def _healthy(good: Figures) -> list[Figures]:
    drives, vehicles = good["false"]["trials"], good["vehicles"]
    enough = drives >= HEALTHY_DRIVES and vehicles >= HEALTHY_VEHICLES
    wanted = f"{HEALTHY_DRIVES} of {HEALTHY_VEHICLES} are wanted"
    why = "" if enough else f"{drives} drives of {vehicles} vehicles, {wanted}"
    where = f"healthy drives of {vehicles} vehicles"
    counts = []
    for what, events in (("pending", good["false"]["events"]), ("confirmed", good["confirmed"])):
        found = rate(events, drives)
        counts.append(
            {
                "what": f"drives with a {what} code",
                "where": where,
                "unit": "drives",
                "wanted": 0,
                "found": events,
                "low": None if found["low"] is None else found["low"] * drives,
                "high": None if found["high"] is None else found["high"] * drives,
                "trials": drives,
                "met": False if events else True if enough else None,
                "proved": None,
                "missed_by": float(events),
                "why": why,
            }
        )
    completed = _share(
        "test completed", "healthy WLTCs, all weather", COMPLETED, good["completed_wltc"]
    )
    return [*counts, completed]
