"""Scenario files and --fault: what they mean, what is refused, what is compared."""

import math
from pathlib import Path
from typing import Any

import pytest

from monitor.base.errors import ConfigError, UsageError
from monitor.inject.expected import compare
from monitor.inject.injection import Injection
from monitor.inject.scenario import Expectation, Scenario, load, parse_fault


def read(folder: Path, text: str) -> Scenario:
    path = folder / "s.toml"
    path.write_text(text, encoding="utf-8")
    return load(path)


def test_a_scenario_says_when_what_and_how_strong_and_what_is_expected(tmp_path: Path) -> None:
    scenario = read(
        tmp_path,
        """
        title = "late"
        seed = 7
        drives = 2
        keep_counters = true
        [[fault]]
        name = "delay_symmetric"
        severity = 0.8
        start_s = 60
        end_s = 90.5
        drives = [2]
        [[fault]]
        name = "frame_loss"
        messages = ["ECU_Air", "ECU_Fuel"]
        [[expect]]
        code = "none"
        drive = 1
        [[expect]]
        code = "P0421"  # of a close-coupled catalyst
        state = "pending"
        within_s = 45.0
        """,
    )
    late = Injection("delay_symmetric", 0.8, 60.0, 90.5, drives=(2,))
    lost = Injection("frame_loss", 0.1, messages=("ECU_Air", "ECU_Fuel"))
    assert scenario == Scenario(
        faults=(late, lost),
        expectations=(Expectation("none", 1), Expectation("P0421", 2, "pending", 45.0)),
        title="late",
        seed=7,
        n_drives=2,
        keep_counters=True,
    )
    assert scenario.faults_of(1) == (lost,)
    assert scenario.faults_of(2) == (late, lost)
    assert [scenario.begin_s(drive) for drive in (1, 2)] == [0.0, 0.0]


FAULT = '[[fault]]\nname = "gain_low"\n'
EXPECT = '[[expect]]\ncode = "P2A00"\n'


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("speed = 1", "has the unknown key 'speed', known are drives, expect"),
        (FAULT + "strength = 0.5", "[[fault]] 1: has the unknown key 'strength'"),
        (FAULT + FAULT + "start = 0.5", "[[fault]] 2: has the unknown key 'start'"),
        (EXPECT + "within = 5", "[[expect]] 1: has the unknown key 'within'"),
        ("[[fault]]\nseverity = 1.0", "[[fault]] 1: name is missing"),
        ('[[fault]]\nname = "slow"', "[[fault]] 1: fault 'slow' is unknown; there are slow_"),
        ("[[expect]]\ndrive = 1", "[[expect]] 1: code is missing"),
        (FAULT + "severity = 1.5", "[[fault]] 1: fault gain_low: severity 1.5"),
        (FAULT + 'severity = "much"', "[[fault]] 1: severity is 'much', a number is wanted"),
        (FAULT + "severity = nan", "severity is nan, a number is wanted"),
        (FAULT + "severity = true", "severity is True, a number is wanted"),
        (FAULT + "start_s = 9.0\nend_s = 8.0", "acts from 9 s to 8 s"),
        (FAULT + "start_s = -1.0", "acts from -1 s"),
        (FAULT + 'messages = ["ECU_Air"]', "messages are for faults of frames"),
        (FAULT + "can_id = 5", "can_id is for frame_flood"),
        (FAULT + "drives = [2]", "drives is [2], numbers from 1 to 1 are wanted"),
        (FAULT + "drives = []", "drives is [], at least one is wanted"),
        (FAULT + "drives = [true]", "drives is [True], whole numbers are"),
        ('[[fault]]\nname = "frame_loss"\nmessages = "all"', "messages is 'all', texts are"),
        ('[[fault]]\nname = "frame_loss"\nseverity = 1.1', "at most 1 is wanted"),
        ('[[fault]]\nname = "frame_flood"\nseverity = 1e6', "at most 20000 is wanted"),
        ('[[fault]]\nname = "frame_flood"\ncan_id = 0x20000000', "more than 29 bits"),
        ('[fault]\nname = "gain_low"', "fault is written as [[fault]]"),
        ("drives = 0", "drives is 0, 1 to 100 is wanted"),
        ("drives = 2.5", "drives is 2.5, a whole number is wanted"),
        ("keep_counters = 1", "keep_counters is 1, true or false is wanted"),
        ("title = 1", "title is 1, a text is wanted"),
        ('[[expect]]\ncode = "P9999"', "code is 'P9999', P0133"),
        (EXPECT + 'state = "permanent"', "state is 'permanent', pending or confirmed is wanted"),
        (EXPECT + "drive = 2", "drive is 2, 1 to 1 is wanted"),
        (EXPECT + "within_s = 0.0", "within_s is 0.0, above 0 is wanted"),
        (EXPECT + "judged = true", "judged says nothing beside code = 'P2A00'"),
        ('[[expect]]\ncode = "none"\nwithin_s = 5.0', "within_s says nothing beside code"),
        (EXPECT + EXPECT, "contradict each other or repeat"),
        (EXPECT + '[[expect]]\ncode = "none"', "contradict each other or repeat"),
        ("title = ", "not a TOML file"),
    ],
)
def test_a_wrong_scenario_is_named_with_file_and_key(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, text)
    assert str(caught.value).startswith(f"{tmp_path / 's.toml'}: ")
    assert says in str(caught.value)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("gain_low", Injection("gain_low", 0.5)),
        ("gain_low=0.4", Injection("gain_low", 0.4)),
        ("gain_low@60", Injection("gain_low", 0.5, 60.0)),
        ("noise=0.01@1.5-2.5", Injection("noise", 0.01, 1.5, 2.5)),
        ("signal_invalid@1e1-2e1", Injection("signal_invalid", 1.0, 10.0, 20.0)),
    ],
)
def test_a_fault_of_the_command_line(text: str, wanted: Injection) -> None:
    assert parse_fault(text) == wanted


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("gain_low=", "wanted NAME"),
        ("gain_low@", "wanted NAME"),
        ("gain_low@5-", "wanted NAME"),
        ("gain_low=a", "wanted NAME"),
        ("gain_low@nan", "acts from nan s"),
        ("gain_low@inf", "acts from inf s"),
        ("gain_low@5-4", "acts from 5 s to 4 s"),
        ("", "fault '' is unknown"),
        ("healthy", "fault 'healthy' is unknown"),
        ("noise=inf", "severity inf is not within"),
        ("drop_outs=1", "at most 0.95 is wanted"),
        ("frame_delay=-1", "severity -1 is not within"),
        ("frame_delay=1e12", "severity 1e+12 is not within"),
        ("delay_symmetric=1e300", "severity 1e+300 is not within"),
    ],
)
def test_what_is_no_fault_is_refused(text: str, says: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_fault(text)
    assert says in str(caught.value)


def recording(*dtcs: tuple[str, str, float | None], completed: bool = True) -> dict[str, Any]:
    entries = [
        {"code": code, "fault": "f", "state": state, "t_s": t_s} for code, state, t_s in dtcs
    ]
    return {"dtcs": entries, "completed": completed, "not_judged": None}


def met(scenario: Scenario, *recordings: dict[str, Any]) -> list[bool]:
    return [row.met for row in compare(scenario, recordings)]


LATE = Injection("delay_symmetric", 0.8, start_s=60.0)


@pytest.mark.parametrize(
    ("state", "within_s", "came", "is_met"),
    [
        ("", math.inf, ("P015A", "pending", 5.0), True),
        ("", math.inf, ("P015A", "confirmed", None), True),
        ("confirmed", math.inf, ("P015A", "pending", 70.0), False),
        ("pending", 30.0, ("P015A", "pending", 90.0), True),
        ("pending", 30.0, ("P015A", "pending", 90.1), False),
        ("pending", 30.0, ("P015A", "pending", 59.0), False),  # before the fault
        ("", 30.0, ("P015A", "confirmed", None), False),  # of an earlier drive
        ("", math.inf, ("P015B", "pending", 90.0), False),
    ],
)
def test_an_expected_code_is_met_by_its_state_in_its_time(
    state: str, within_s: float, came: tuple[str, str, float | None], is_met: bool
) -> None:
    scenario = Scenario((LATE,), (Expectation("P015A", 1, state, within_s),))
    assert met(scenario, recording(came))[0] is is_met


def test_no_code_is_met_only_by_a_drive_that_was_judged() -> None:
    strict = Scenario((), (Expectation("none", 1),))
    lenient = Scenario((), (Expectation("none", 1, judged=False),))
    assert met(strict, recording()) == [True]
    assert met(strict, recording(completed=False)) == [False]
    assert met(lenient, recording(completed=False)) == [True]
    assert met(lenient, recording(("P2A00", "pending", 1.0))) == [False]
