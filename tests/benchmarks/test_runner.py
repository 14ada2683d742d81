"""The run, the targets and the tables that all studies share, and what none can use."""

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from scipy import stats

from benchmarks.__main__ import main
from benchmarks.studies import runner, targets
from benchmarks.studies.options import option, parser_of, plan_of
from benchmarks.studies.report import Report, Section
from benchmarks.studies.tables import Row, answers, cells, confusion, grouped, median
from benchmarks.studies.targets import Target
from monitor.base.errors import UsageError
from training.limits.rates import per_1000_h, rate


@dataclass(frozen=True, slots=True)
class Plan:
    """A plan of a study that counts."""

    trials: int = option(4, "how many")
    wet: bool = option(False, "in rain")
    names: tuple[str, ...] = option((), "of cycles")


def count(shared: list[int], item: int) -> dict[str, Any]:
    if item == shared[0]:
        raise KeyboardInterrupt
    return {"rows": [{"number": item}]}


def report(rows: Sequence[Row]) -> Report:
    found = targets.share("counted", "trials", rate(len(rows), 4), 0.9)
    return Report("Counting", [f"{len(rows)} trials"], [found], [Section("Rows", rows)])


def arguments(*words: str) -> argparse.Namespace:
    args = parser_of("count", Plan, "Count.", lambda _: 0).parse_args(words)
    args.out = args.out and Path(args.out)
    return args


def do(folder: Path, stops_at: int, plan: Plan) -> list[Row]:
    args = arguments("--out", str(folder), "--jobs", "1")
    with runner.running("count", args, plan, 4, report) as place:
        place.do(count, [stops_at], {f"trial_{i}": i for i in range(4)})
    return place.rows()


def test_a_quantile_of_few_values_has_no_bounds() -> None:
    for values, at, bounds in ((range(20), 0.99, (18.0, None)), (range(3), 0.1, (None, 2.0))):
        found = targets.quantile("", "", [float(each) for each in values], at)
        assert (found.low, found.high) == bounds


def test_a_stopped_run_reports_what_it_has_and_goes_on_where_it_stopped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # GIVEN a run that is stopped in its third trial
    with pytest.raises(KeyboardInterrupt):
        do(tmp_path, 2, Plan())
    assert "2 trials\ntrials: counted: 50.0 %" in capsys.readouterr().out
    made = {path: path.stat().st_mtime_ns for path in (tmp_path / "rows").iterdir()}
    # WHEN it is begun again
    rows = do(tmp_path, -1, Plan())
    # THEN only the rest is done, and the report holds all
    assert [r["number"] for r in rows] == [0, 1, 2, 3]
    assert all(path.stat().st_mtime_ns == at for path, at in made.items())
    result = json.loads((tmp_path / "count.json").read_text())
    assert (result["source"], result["plan"]["trials"]) == ("simulated", 4)
    assert result["targets"][0]["found"] == 1.0
    assert len(result["tables"]["Rows"]) == 4
    page = (tmp_path / "report.html").read_text()
    assert "1 of 1 targets are met" in page
    assert ">Rows</h2>" in page
    # and a folder belongs to one plan
    with pytest.raises(UsageError, match="another plan; choose another --out"):
        do(tmp_path, -1, Plan(trials=5))


def test_options_are_the_fields_of_the_plan() -> None:
    args = arguments("--out", "x", "--trials", "7", "--wet", "--names", "a", "b")
    assert plan_of(Plan, args) == Plan(7, True, ("a", "b"))
    assert plan_of(Plan, arguments("--out", "x")) == Plan()
    with pytest.raises(UsageError, match="--out DIR is needed"):
        plan_of(Plan, arguments())
    with pytest.raises(UsageError, match="--jobs is at least 1"):
        plan_of(Plan, arguments("--out", "x", "--jobs", "0"))


def test_a_target_is_missed_by_one_drive_too_many_and_proved_by_many() -> None:
    few = targets.share("found", "0.06 g", rate(98, 99), 0.99)
    assert (few.met, few.verdict) == (False, "missed by 0.0 points")
    assert few.low == pytest.approx(stats.binomtest(98, 99).proportion_ci().low)
    unproved = targets.share("found", "", rate(98, 98), 0.99)
    assert (unproved.met, unproved.proved) == (True, False)
    assert targets.share("found", "", rate(500, 500), 0.99).proved
    assert targets.share("found", "", rate(0, 0), 0.99).verdict == "not judged: no such drive"
    both = targets.share("covered", "", rate(93, 100), 0.88, 0.92)
    assert both.verdict == "missed by 1.0 points"
    assert targets.share("called", "", rate(1, 50), most=0.0).verdict == "missed by 2.0 points"


def test_a_time_of_never_misses_and_a_count_of_few_drives_meets_nothing() -> None:
    never = targets.time("median", "", median([1.0, None, None]), 60.0)
    assert (never.met, never.as_row()["found"]) == (False, None)
    assert never.verdict == "missed: more than half are never found"
    assert targets.time("median", "", median([3.0, 5.0]), 4.0).met
    few = Target("codes", "", "drives", 0.0, trials=9, most=0.0, why="9 drives are few")
    assert (few.met, few.verdict) == (None, "not judged: 9 drives are few")
    assert Target("codes", "", "drives", 1.0, trials=9, most=0.0, why="few").verdict == (
        "missed by 1"
    )


def test_rates_and_times_come_with_their_bounds() -> None:
    assert rate(0, 0)["rate"] is None
    assert per_1000_h(2, 3.6e6)["per_1000_h"] == pytest.approx(2.0)
    assert median([3.0, 1.0, 2.0, None, None])["median"] == 3.0
    # the 95 % bounds of ten values are their second and ninth: 1 - 2 * 11 / 1024 = 97.9 %
    ten = median([float(i) for i in range(1, 11)])
    assert (ten["low"], ten["median"], ten["high"]) == (2.0, 5.5, 9.0)


def test_tables_count_every_row_once() -> None:
    pairs = [("purge", "purge"), ("purge", "none"), ("nothing", "none"), ("odd", "purge + none")]
    order = ("nothing", "none", "purge")
    found = answers([*pairs, pairs[0]], order)
    assert [tuple(r.values()) for r in found] == [
        ("nothing", "none", 1),
        ("purge", "none", 1),
        ("purge", "purge", 2),
        ("odd", "purge + none", 1),
    ]
    drawn = confusion(found, order)
    assert drawn
    values = [cell.value for _, row in drawn.rows for cell in row if cell.value]
    assert values == ["100", "33", "67", "100"]
    assert list(drawn.columns) == ["none", "purge", "several names"]
    assert confusion([]) is None
    rows = [{"a": 1, "b": 2}, {"a": 1, "b": 3}, {"a": 2, "b": 2}]
    parts = grouped(rows, ("a",), lambda own: {"n": len(own), "share": rate(1, len(own))})
    assert [(p["a"], p["n"]) for p in parts] == [(1, 2), (2, 1)]
    head, body = cells(parts)
    assert head == ["a", "n", "share"]
    assert body[1][:2] == ["2", "1"]
    assert body[1][2].startswith("100.0")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("Time,RPM\n", "no row of column names"),
        ("time_s,lambda_measured\n0,1\n1,1\n", "tables need"),
    ],
)
def test_a_log_without_what_tables_need_ends_in_one_line_that_names_it(
    tmp_path: Path, text: str, why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "drive.csv"
    log.write_text(text)
    assert main(["tables", "--logs", str(log)]) == 2
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 1
    assert told[0].startswith(f"tables: {log}: ")
    assert why in told[0]
