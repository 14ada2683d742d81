"""The catalyst matrix: plan, tables, and the command."""

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks.studies.behind import run, tables
from benchmarks.studies.behind.drive import settled
from benchmarks.studies.behind.plan import CatalystMatrix, trials
from benchmarks.studies.catalyst import main
from monitor.base import config
from monitor.base.errors import UsageError
from monitor.judge.catalyst.rule import Claim
from monitor.judge.catalyst.watch import BehindResult

FIRST = 29_001


def a_row(true_g: float, **changed: Any) -> dict[str, Any]:
    """A drive as the matrix keeps it, judged rightly and without a fault beside the catalyst's."""
    low = true_g <= 0.06
    return {
        "kind": "main",
        "number": 0,
        "mode": "cut",
        "ambient": "mild",
        "grams": true_g,
        "true_g": true_g,
        "driving_s": 600.0,
        "ethanol": 0.0,
        "leak": 0.0,
        "sensor": "",
        "upstream": "",
        "offset_lambda": 0.0,
        "segments": 100,
        "capacity_g": true_g,
        "capacity_low_g": 0.8 * true_g,
        "capacity_high_g": 1.2 * true_g,
        "capacity_is_bound": False,
        "upstream_offset_lambda": 0.001,
        "upstream_offset_std": 0.002,
        "faults": {"catalyst": "catalyst_low"} if low else {},
        "passed_s": {} if low else {"catalyst": 100.0},
        "decided_s": 100.0,
        "rules": dict.fromkeys(tables.TITLES, 1.0 if low else 0.1),
    } | changed


def counts(found: dict[str, Any], *names: str) -> list[tuple[int, int]]:
    return [(found[name]["events"], found[name]["trials"]) for name in names]


def test_every_verdict_is_counted_against_the_true_capacity() -> None:
    # GIVEN one right and one wrong verdict on either side, and a capacity between
    wrong = {"faults": {"catalyst": "catalyst_low"}, "passed_s": {"catalyst": 50.0}}
    rows = [a_row(0.06), a_row(0.03, faults={}, passed_s={"catalyst": 9.0}), a_row(0.25)]
    rows += [a_row(0.4, **wrong), a_row(0.15, **wrong)]
    found = tables.verdicts(rows)
    assert counts(found, "low found", "low passed") == [(1, 2), (1, 2)]
    assert counts(found, "sound called", "sound passed") == [(1, 2), (2, 2)]


def test_a_lower_bound_is_covered_but_no_estimate() -> None:
    bound = a_row(1.0, capacity_g=0.5, capacity_is_bound=True, capacity_high_g=None)
    outside = a_row(0.4, capacity_g=0.5, capacity_low_g=0.45, capacity_high_g=0.55)
    found = tables.estimates([bound, outside, a_row(0.4)])
    assert (found["estimates"], found["lower bounds"]) == (2, 1)
    assert counts(found, "covered") == [(2, 3)]
    assert found["bias"] == pytest.approx(1.25**0.5 - 1.0)


def test_an_offset_is_named_by_the_balance_that_belongs_to_it() -> None:
    right = a_row(0.4, upstream="biased_lean", faults={"balance": "balance_rich"})
    wrong = a_row(0.4, upstream="biased_rich", faults={"balance": "balance_rich"})
    called = a_row(0.4, faults={"balance": "balance_lean"})
    found = tables.offsets([right, wrong, a_row(0.4), called])
    assert counts(found, "offset named", "called without one") == [(1, 2), (1, 2)]


def test_false_alarms_are_those_of_drives_without_any_fault() -> None:
    slow = a_row(0.4, sensor="downstream_slow_symmetric", faults={"downstream": "downstream_late"})
    called = a_row(0.4, faults={"balance": "balance_lean"})
    (found,) = tables.false_alarms([slow, a_row(0.06), called])
    assert counts(found, "with a code") == [(1, 1)]
    assert found["per 1000 h"]["per_1000_h"] == pytest.approx(6000.0)


def test_a_rule_is_judged_on_the_drives_on_which_it_has_something_to_look_at() -> None:
    blind = a_row(0.06, rules=dict.fromkeys(tables.TITLES))
    found = tables.rule_figures([a_row(0.06), a_row(0.25), blind], "delay", limit=0.5)
    assert counts(found, "found", "false") == [(1, 1), (0, 1)]
    assert found["nothing to look at"] == 1


def test_a_fault_counts_when_two_results_in_a_row_agree() -> None:
    def results(*outcomes: str) -> list[BehindResult]:
        claims = [Claim(o, "catalyst_low") for o in outcomes]  # type: ignore[arg-type]
        return [BehindResult(50 * i, "catalyst", claim) for i, claim in enumerate(claims, 1)]

    debounce = config.shipped().debounce
    once = settled(results("failed", "passed", "failed"), debounce)
    twice = settled(results("failed", "failed", "passed", "passed"), debounce)
    assert once == {"faults": {}, "faults_s": {}, "passed_s": {}}
    assert twice["faults_s"] == {"catalyst": 10.0}
    assert twice["passed_s"] == {"catalyst": 20.0}


def test_the_plan_has_every_kind_and_no_vehicle_twice() -> None:
    planned = trials(CatalystMatrix(400, FIRST))
    assert len({t.vehicle for t in planned}) == 400
    assert [t.kind for t in planned].count("wrong") == 100
    main_ = [t for t in planned if t.kind == "main"]
    assert {t.mode for t in main_} == {"passive", "cut", "active"}
    assert {t.ambient for t in main_} == {"mild", "hot", "cold", "altitude"}
    assert all(t.sensor == t.upstream == "" for t in planned if t.kind == "wrong")
    with pytest.raises(UsageError, match="set limits"):
        trials(CatalystMatrix(1, 16))


def test_the_command_drives_the_catalyst_and_reports_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("benchmarks.studies.behind.rules.limits.__defaults__", ((3,),))
    args = ["--out", str(tmp_path), "--drives", "3", "--seconds", "240"]
    args += ["--first-vehicle", str(FIRST), "--jobs", "1"]
    assert main(args) == 0
    # THEN text, JSON and page say what was found, and that it is simulated
    said = capsys.readouterr().out
    assert "2 main, 1 with wrong metering or fuel, 0 of a second engine" in said
    assert "0.06 g: found: 100.0 % (2.5 % to 100.0 %) of 1" in said
    result = json.loads((tmp_path / "catalyst.json").read_text())
    assert result["source"] == "simulated"
    verdicts = result["tables"]["Verdicts on the catalyst"]
    assert counts(verdicts[0], "low found") == [(1, 1)]
    rules = result["tables"]["Rules of the field on the same drives"]
    assert [r["rule"] for r in rules] == list(tables.TITLES.values())
    assert "no figure is final" in (tmp_path / "report.html").read_text()
    # WHEN it is asked for again THEN nothing is driven anew
    monkeypatch.setattr(run, "row", None)
    assert main(args) == 0
