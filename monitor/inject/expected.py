"""The codes of each drive beside a scenario's expectations."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from monitor.base.files.junit import JunitCase
from monitor.inject.scenario import NO_CODE, Expectation, Scenario
from monitor.judge.causes.causes import Cause

Recording = Mapping[str, Any]  # an entry of o2mon.replay/1


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table: an expectation, and the codes that were set."""

    drive: int
    expected: str
    seen: str
    met: bool


def compare(scenario: Scenario, recordings: Sequence[Recording]) -> list[Row]:
    """Return a row per expectation, and a row per unexpected code.

    recordings : results of the scenario's drives, in order
    """
    rows = []
    for drive, recording in enumerate(recordings, 1):
        expected = [e for e in scenario.expectations if e.drive == drive]
        begin_s = scenario.begin_s(drive)
        rows += [_row(expectation, recording, begin_s) for expectation in expected]
        if expected and scenario.faults_of(drive) and not recording.get("n_changed", 1):
            rows.append(Row(drive, "a fault that changes something", "nothing changed", False))
        if not expected or any(e.code == NO_CODE for e in expected):
            continue  # the drive has no expectation, or the row above covers every code
        rows += [
            Row(drive, "no other code", _seen(dtc, begin_s), False)
            for dtc in recording["dtcs"]
            if dtc["code"] not in {e.code for e in expected}
        ]
    return rows


def _row(expected: Expectation, recording: Recording, begin_s: float) -> Row:
    seen = ", ".join(_seen(dtc, begin_s) for dtc in recording["dtcs"]) or "no code"
    if not recording["completed"]:
        why = [Cause(**cause).in_words for cause in recording["not_judged"] or ()]
        seen = ": ".join([f"{seen}, not judged", *why[:1]])
    if expected.code == NO_CODE:
        met = not recording["dtcs"] and (recording["completed"] or not expected.judged)
        return Row(expected.drive, str(expected), seen, met)
    for dtc in recording["dtcs"]:
        if dtc["code"] == expected.code:
            late_s = math.inf if dtc["t_s"] is None else dtc["t_s"] - begin_s
            in_time = math.isinf(expected.within_s) or 0.0 <= late_s <= expected.within_s
            met = in_time and expected.state in ("", dtc["state"])
            return Row(expected.drive, str(expected), _seen(dtc, begin_s), met)
    return Row(expected.drive, str(expected), seen, False)


def _seen(dtc: Mapping[str, Any], begin_s: float) -> str:
    when = "" if dtc["t_s"] is None else f" after {dtc['t_s'] - begin_s:.1f} s"
    return f"{dtc['code']} {dtc['state']} ({dtc['fault']}){when}"


def table(rows: Iterable[Row]) -> Iterator[str]:
    """Yield the lines of the table."""
    cells = [("drive", "expected", "seen", "")]
    cells += [(str(r.drive), r.expected, r.seen, "met" if r.met else "NOT MET") for r in rows]
    widths = [max(len(cell) for cell in column) for column in zip(*cells, strict=True)]
    for line in cells:
        yield "  ".join(f"{cell:<{w}}" for cell, w in zip(line, widths, strict=True)).rstrip()


def case(name: str, rows: Sequence[Row]) -> JunitCase:
    """Return the test case of a scenario; it fails if an expectation is not met."""
    unmet = [row for row in rows if not row.met]
    said = "; ".join(f"drive {row.drive}: {row.expected}, seen {row.seen}" for row in unmet)
    return JunitCase(name, "\n".join(table(rows)), said, unmet[0].expected if unmet else "")
