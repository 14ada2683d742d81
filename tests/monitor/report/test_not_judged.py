"""Why a drive was not judged: condition, share, signal, reason and advice in every output."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor import cli
from monitor.base.types import Frame
from tests.conftest import ROOT
from tests.helpers.drives.drive_tables import PERIOD_S, Columns, columns, table
from tests.helpers.logs.injected_frames import LAMBDA_ID, write
from tests.helpers.logs.replays import frames_of, replays

Change = Callable[[Columns], None]


@dataclass(frozen=True, slots=True)
class Replayed:
    exit_code: int
    out: str
    page: str
    recording: dict[str, Any]

    @property
    def causes(self) -> list[tuple[str, str | None, str]]:
        found = self.recording["not_judged"] or []
        return [(c["condition"], c["signal"], c["reason"]) for c in found]


Replay = Callable[[Change], Replayed]


@pytest.fixture
def replayed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Replay:
    def run(change: Change) -> Replayed:
        path = table(tmp_path / "drive.csv", change)
        page = tmp_path / "page.html"
        code, (recording,) = replays(path, "--html", page)
        return Replayed(code, capsys.readouterr().out, page.read_text(), recording)

    return run


def held(name: str, value: float, seconds: float | None = None) -> Change:
    """Return a change that holds a column at a value, throughout or for its last seconds."""

    def change(data: Columns) -> None:
        n = len(data[name]) if seconds is None else round(seconds / PERIOD_S)
        data[name][-n:] = value

    return change


def stopped(data: Columns) -> None:
    held("engine_speed_rpm", 0.0, 2.0)(data)
    held("lambda_measured", np.nan, 1.5)(data)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda _: None, id="nothing holds a healthy drive up"),
        pytest.param(stopped, id="a sensor may be silent while the engine stands"),
        pytest.param(
            held("lambda_measured", np.nan, 0.2), id="a last bad sample is no dead sensor"
        ),
    ],
)
def test_a_drive_in_which_every_test_passed_is_judged(replayed: Replay, change: Change) -> None:
    got = replayed(change)
    assert (got.exit_code, got.recording["not_judged"]) == (0, None)
    assert ": no fault" in got.out


def test_a_reading_that_fails_now_and_then_stands_first(replayed: Replay) -> None:
    def torn(data: Columns) -> None:
        data["lambda_measured"][::7] = 99.0

    assert replayed(torn).causes[0] == ("measured_valid", "lambda_measured", "out_of_range")


@pytest.mark.parametrize(
    ("change", "cause", "words"),
    [
        (
            held("purge_duty_percent", np.nan),  # the edges of fuel cuts tell of the response
            ("purge_steady", "purge_duty_percent", "invalid"),
            "purge_duty_percent has no value in 100 % of the samples",
        ),
        (
            held("lambda_controller", 1.0),
            ("closed_loop", "lambda_controller", "constant"),
            "the loop was never closed: lambda_controller is 1 throughout",
        ),
    ],
    ids=["blank, but cuts", "a still controller"],
)
def test_a_drive_without_a_verdict_names_the_column_at_fault(
    replayed: Replay, change: Change, cause: tuple[str, str, str], words: str
) -> None:
    got = replayed(change)
    assert (got.exit_code, got.recording["dtcs"], got.causes[0]) == (3, [], cause)
    assert words in got.out  # in the text
    assert words.replace("'", "&#x27;") in got.page  # and on the page
    assert got.recording["not_judged"][0]["held_share"] < 0.1
    is_part = got.recording["tests"]["response"] == "undecided"  # it hides no test that passed
    assert ("no fault in activity; not judged" in got.out) == is_part


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (held("lambda_measured", np.nan, 1.5), "invalid"),
        (held("lambda_measured", 0.3, 1.5), "out_of_range"),
        (held("sensor_ready", 0.0, 12.0), "not_ready"),
        (held("lambda_measured", 1.02, 11.0), "frozen"),
        (held("lambda_measured", 15.9, 11.0), "pegged"),
    ],
    ids=["no value", "implausible", "not ready", "frozen", "pegged"],
)
def test_a_sensor_that_dies_after_its_tests_passed_gives_no_clean_bill(
    replayed: Replay, change: Change, reason: str
) -> None:
    # GIVEN a drive in which every test passes, and a sensor that dies too late for a code
    got = replayed(change)
    # THEN it is not judged, although the response test was completed
    assert (got.exit_code, got.recording["completed"]) == (3, True)
    assert got.causes == [("sensor_alive", "lambda_measured", reason)]


@pytest.mark.parametrize(("is_cut", "exit_code"), [(1.0, 0), (0.0, 3)], ids=["cut", "burning"])
def test_a_reading_that_a_logger_pins_is_no_dead_sensor_in_the_last_fuel_cut_alone(
    tmp_path: Path, is_cut: float, exit_code: int
) -> None:
    def end(data: Columns) -> None:
        held("lambda_measured", 15.9, 3.0)(data)
        held("fuel_cut", is_cut, 20.0)(data)

    path, profile = table(tmp_path / "drive.csv", end), tmp_path / "logger.toml"
    lines = ['title = "own"', 'time = "time_s"', "[signals]", *(f"{n} = '{n}'" for n in columns())]
    pinned = "{ column = 'lambda_measured', pinned = [15.9] }"
    profile.write_text("\n".join(lines).replace("'lambda_measured'", pinned))
    model = ROOT / "monitor" / "model" / "shipped.onnx"
    assert replays(path, "--profile", profile, "--model", model)[0] == exit_code


def test_a_drive_too_short_for_its_tests_says_which_have_no_decision(replayed: Replay) -> None:
    # GIVEN a stretch of the drive in which every condition holds, too short for a decision
    def cut(data: Columns) -> None:
        data.update({name: column[2360:2460] for name, column in data.items()})

    got = replayed(cut)
    # THEN the reason is the time, and the advice a longer drive: its inputs were never interrupted
    assert (got.exit_code, got.causes[0][0]) == (3, "model_settled")
    assert "record drives longer than the model remembers" in got.out


def test_a_check_names_what_blocks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    healthy = table(tmp_path / "healthy.csv")
    zeros = table(tmp_path / "zeros.csv", held("vehicle_speed_km_h", 0.0))
    off = table(tmp_path / "off.csv", held("engine_speed_rpm", 0.0))
    assert cli.main(["check", str(healthy), str(zeros), str(off)]) == 0
    of_healthy, of_zeros, of_off = re.split("(?:zeros|off).csv\n", capsys.readouterr().out)
    assert "hold up" not in of_healthy and "speed_km_h is 0 km/h throughout" in of_zeros
    # AND an engine that never ran is the only reason: there is nothing to train on
    assert of_off.count("would hold up a verdict") == of_off.count("the engine never runs") == 1


@pytest.fixture(scope="module")
def drive() -> list[Frame]:
    return frames_of("healthy_micro_trips", 120.0)


@pytest.fixture
def deaf(drive: list[Frame], tmp_path: Path) -> Path:
    return write(tmp_path / "deaf.blf", [f for f in drive if f.can_id != LAMBDA_ID])


def test_a_sensor_that_never_came_in_a_log_is_not_judged_and_gets_no_code(deaf: Path) -> None:
    code, (recording,) = replays(deaf)
    assert code == 3
    assert recording["dtcs"] == []
    cause = recording["not_judged"][0]
    assert (cause["signal"], cause["reason"]) == ("lambda_measured", "never_seen")
    assert "ECU_Lambda.LambdaMeasured" in cause["advice"]


def test_a_vehicle_whose_sensor_was_heard_before_gets_the_code(
    deaf: Path, drive: list[Frame], tmp_path: Path
) -> None:
    healthy, memory = write(tmp_path / "healthy.blf", drive), tmp_path / "memory.db"
    replays(healthy, "--memory", memory)
    code, (recording,) = replays(deaf, "--memory", memory)
    assert code == 1
    assert [d["code"] for d in recording["dtcs"]] == ["U0100"]
