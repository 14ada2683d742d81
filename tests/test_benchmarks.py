"""The benchmarks name only what the project has, and each one kept measures something."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.__main__ import benchmarks, main
from benchmarks.outcome import SCHEMA, BenchmarkOptions, finish
from benchmarks.repository import ROOT

OF_OTHER_TESTS = {"matrix", "catalyst", "gap", "soak"}
DATA = ROOT.parent / "shared" / "data"
NEEDED = {  # data that the repository does not hold
    "bosch_verdicts": DATA / "bosch_gengine1",
    "gap_bosch": DATA / "bosch_gengine1",
    "real_logs": DATA / "logs",
    "map_proposals": DATA / "opendbc",
}
FORKING = {"fuzz_databases", "fuzz_logs"}  # in a process of their own
GIVEN = {
    "bosch_verdicts": ["1:30"],
    "map_proposals": [str(NEEDED["map_proposals"])],
    "fuzz_databases": ["--cases", "40", "--seed", "21"],  # their only tests
    "fuzz_logs": ["--cases", "60", "--seed", "10"],
}


def test_the_runner_lists_each_benchmark_in_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    listed = capsys.readouterr().out
    for name, (_, purpose) in benchmarks().items():
        assert purpose
        assert any(name in line and purpose in line for line in listed.splitlines())


def test_an_unknown_benchmark_ends_with_exit_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["no_such"]) == 2
    assert "no_such" in capsys.readouterr().err


@pytest.mark.parametrize("name", sorted(benchmarks().keys() - OF_OTHER_TESTS))
def test_a_benchmark_at_its_smallest_size_measures_something(name: str, tmp_path: Path) -> None:
    if name in NEEDED and not NEEDED[name].is_dir():
        pytest.skip(f"{NEEDED[name]} is not there")
    out = tmp_path / "out.json"
    words = [name, *GIVEN.get(name, []), "--smallest", "--json", str(out)]
    if name in FORKING:
        command = [sys.executable, "-m", "benchmarks", *words]
        ran = subprocess.run(command, cwd=ROOT, capture_output=True, timeout=300, check=False)
        assert ran.returncode == 0, ran.stderr[-2000:]
    else:
        assert main(words) == 0
    found = json.loads(out.read_text())
    assert (found["schema"], found["benchmark"]) == (SCHEMA, name)
    assert found["commit"]
    assert found["rows"]


def test_a_benchmark_that_measured_nothing_ends_with_an_error() -> None:
    args = BenchmarkOptions("benchmarks.speed.some", "Some.").parse_args([])
    for rows in ([], [{"log": "a", "seconds": None}, {"log": "b", "seconds": float("nan")}]):
        with pytest.raises(SystemExit, match="some: nothing was measured"):
            finish(args, rows)


def test_what_is_given_stands_before_what_is_smallest() -> None:
    options = BenchmarkOptions("benchmarks.speed.some", "Some.", rounds=1, seconds=2.0)
    options.add_argument("--rounds", type=int, default=5)
    options.add_argument("--seconds", type=float, default=60.0)
    args = options.parse_args(["--smallest", "--rounds", "3"])
    assert (args.rounds, args.seconds) == (3, 2.0)


def test_a_missed_target_is_said_and_ends_with_exit_code_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.json"
    args = BenchmarkOptions("benchmarks.speed.some", "Some.").parse_args(["--json", str(out)])
    assert finish(args, [{"log": "a", "us": 3.0}], ["3 us, wanted 2"]) == 1
    assert "missed: 3 us, wanted 2" in capsys.readouterr().out
    assert json.loads(out.read_text())["missed"] == ["3 us, wanted 2"]
