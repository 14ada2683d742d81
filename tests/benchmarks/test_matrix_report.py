"""Rates, targets and tables of a matrix."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from scipy import stats

from benchmarks.studies.rules.alarms import Scored
from benchmarks.studies.sensor import tables
from benchmarks.studies.sensor.goals import beyond_limit
from benchmarks.studies.sensor.matrix_result import verdict
from benchmarks.studies.sensor.targets import assess
from tests.helpers.matrices import FIRST, SEED
from training.limits.rates import median, per_1000_h, rate, roc


def test_rates_times_and_false_alarms_come_with_their_bounds() -> None:
    found = rate(59, 60)
    assert found["low"] == pytest.approx(stats.binomtest(59, 60).proportion_ci().low)
    assert rate(0, 0)["rate"] is None
    assert per_1000_h(0, 3.6e6)["high"] == pytest.approx(-np.log(0.05))
    assert per_1000_h(2, 3.6e6)["per_1000_h"] == pytest.approx(2.0)
    assert median([3.0, 1.0, 2.0, None, None])["median"] == 3.0
    assert median([1.0, None, None])["median"] is None
    # the 95 % bounds of ten values are their second and ninth: 1 - 2 * 11 / 1024 = 97.9 %
    ten = median([float(i) for i in range(1, 11)])
    assert (ten["low"], ten["median"], ten["high"]) == (2.0, 5.5, 9.0)


def test_the_curve_of_a_score_counts_drives_without_one_as_silent() -> None:
    curve = roc([0.0, 1.0, 2.0, None], [3.0, 1.5, None, 4.0])
    assert curve["area"] == pytest.approx(
        np.mean(
            [
                [1.0 if f > h else 0.5 if f == h else 0.0 for h in (0, 1, 2, -9)]
                for f in (3.0, 1.5, -9, 4.0)
            ]
        )
    )
    assert curve["at_none"] == 0.5
    assert curve["points"][0] == [0.0, 0.0]
    assert curve["points"][-1] == [0.75, 0.75]


def test_a_drive_scores_and_alarms_by_two_windows_in_a_row() -> None:
    scores = np.array([5.0, 1.0, 3.0, 4.0, 0.0])
    assert Scored.of(scores, scores >= 3.0) == Scored(3.0, 3, 3)
    assert Scored.of(scores, scores >= 4.0).alarm is None
    assert Scored.of(scores[:1], scores[:1] >= 3.0) == Scored(None, None, 1)
    assert Scored.of(np.full(2, -np.inf), scores[:2] > 9.0).score is None


def row(
    number: int, fault: str = "", severity: float | None = None, **changes: Any
) -> dict[str, Any]:
    """Return a row of a WLTC; a fault is found and named unless the changes say otherwise."""
    found = [fault] if fault else []
    names = (*tables.TITLES, "monitor")
    return {
        "number": number,
        "kind": "faulty" if fault else "healthy",
        "vehicle": FIRST + number % 2,
        "cycle": "wltc_3b",
        "ambient": "mild",
        "fault": fault,
        "severity": severity,
        "placement": "loop" if fault else "",
        "seed": SEED + number,
        "aged": None,
        "completed": True,
        "codes": ["P0133"] if fault else [],
        "faults": found,
        "also": [],
        "first_code_driving_s": 100.0 if fault else None,
        "first_code_enabled_s": 30.0 if fault else None,
        "driving_s": 1800.0,
        "enabled_s": 900.0,
        "windows": 100,
        "not_held": dict.fromkeys(tables.CONDITIONS, 0.1),
        "scores": dict.fromkeys(names, 1.0 if fault else 0.0),
        "alarms_enabled_s": dict.fromkeys(names, 40.0 if fault else None),
        "failed_windows": dict.fromkeys(names, 50 if fault else 1),
    } | changes


def hand_made() -> list[dict[str, Any]]:
    """Return 60 healthy drives, one with a false code; 40 slow ones, two missed, two misnamed."""
    slow = [row(i, "slow_symmetric", 0.5) for i in range(100, 140)]
    for i in (0, 1):
        slow[i] |= {"codes": [], "faults": [], "first_code_enabled_s": None}
    slow[2]["faults"] = ["transient"]
    slow[4]["faults"] = ["delay_symmetric", "slow_symmetric"]
    slow[3] = row(103, "slow_symmetric", 0.2, codes=[], faults=[], first_code_enabled_s=None)
    healthy = [row(i) for i in range(60)]
    healthy[7] |= {"codes": ["P0133"], "faults": ["slow_symmetric"], "first_code_driving_s": 9.0}
    healthy[9]["completed"] = False
    return healthy + slow


def target(rows: Sequence[dict[str, Any]], what: str, where: str) -> dict[str, Any]:
    return next(t for t in assess(rows) if what in t["what"] and where in t["where"])


def test_targets_stand_beside_what_was_found_and_by_how_much_they_are_missed() -> None:
    rows = hand_made()
    detected = target(rows, "detected", "in the loop, at the limit")
    assert (detected["found"], detected["trials"]) == (37 / 39, 39)
    assert detected["low"] == pytest.approx(stats.binomtest(37, 39).proportion_ci().low)
    assert verdict(detected) == "missed by 4.1 percentage points"
    named = target(rows, "named", "in the loop, at the limit")
    assert named["found"] == 35 / 39
    assert verdict(target(rows, "median", "in the loop, at the limit")) == "met"
    assert target(rows, "detected", "afterwards, at the limit")["met"] is None
    assert verdict(target(rows, "pending", "healthy")) == "missed by 1"
    assert target(rows, "confirmed", "healthy")["met"] is None  # too few drives to say
    completed = target(rows, "completed", "healthy")
    assert (completed["found"], completed["met"], completed["proved"]) == (59 / 60, True, False)


def test_zero_false_codes_are_a_target_met_only_by_many_drives_of_many_vehicles() -> None:
    many = [row(i, vehicle=FIRST + i % 50) for i in range(500)]
    assert target(many, "pending", "healthy")["met"] is True
    assert target(many[:-1], "pending", "healthy")["met"] is None


def test_a_code_of_two_drives_in_a_row_of_a_vehicle_would_be_confirmed() -> None:
    drives = [row(i, vehicle=1) for i in range(4)]
    for i in (0, 2):
        drives[i]["codes"] = ["P0133"]
    assert tables.confirmed(drives) == 0  # drive 1 has passed
    drives[1]["completed"] = False
    assert tables.confirmed(drives) == 1
    drives[2]["vehicle"] = 2
    assert tables.confirmed(drives) == 0


def test_tables_of_hand_made_rows() -> None:
    rows = hand_made()
    cells = {d["severity"]: d for d in tables.detection(rows)}
    assert (cells[0.5]["detected"]["events"], cells[0.2]["detected"]["events"]) == (37, 0)
    names = tables.confusion(rows, "loop")
    counts = dict(zip(names["driven"], names["counts"], strict=True))
    assert counts["slow_symmetric"][names["named"].index("slow_symmetric")] == 35
    assert counts["slow_symmetric"][names["named"].index("transient")] == 1
    assert counts["slow_symmetric"][names["named"].index("none")] == 2
    assert sum(counts["healthy"]) == 60
    assert names["several"] == [
        {"driven": "slow_symmetric", "names": ["delay_symmetric", "slow_symmetric"], "drives": 1}
    ]
    monitor_, card = (
        next(r for r in tables.side_by_side(rows) if r["rule"] == name)
        for name in ("monitor", "paper_card")
    )
    assert monitor_["loop"]["detected"]["rate"] == 37 / 39
    assert card["loop"]["detected"]["rate"] == 1.0
    assert card["false_windows"]["rate"] == 0.01
    assert tables.healthy(rows)["all"]["false_1000_h"]["per_1000_h"] == pytest.approx(1000 / 30)
    assert all(c["area"] == 1.0 for c in tables.curves(rows))


def test_what_must_be_found_begins_at_the_limit_severity() -> None:
    assert beyond_limit("delay_symmetric", 0.4)
    assert not beyond_limit("delay_symmetric", 0.39)
    assert not beyond_limit("gain_low", 0.61)
    assert not beyond_limit("stuck_lean", 0.15)
