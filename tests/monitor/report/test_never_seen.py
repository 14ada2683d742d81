"""A mapped message that never came: the map may be wrong, so the vehicle is not blamed."""

from pathlib import Path

import pytest

from monitor.base.types import Frame
from tests.helpers.logs.injected_frames import LAMBDA_ID, write
from tests.helpers.logs.replays import frames_of, replays


@pytest.fixture(scope="module")
def drive() -> list[Frame]:
    """Give two minutes of a healthy drive."""
    return frames_of("healthy_micro_trips", 120.0)


@pytest.fixture
def deaf(drive: list[Frame], tmp_path: Path) -> Path:
    """Give the drive without the message of the sensor."""
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
    # GIVEN a memory that knows the sensor of an earlier drive
    healthy, memory = write(tmp_path / "healthy.blf", drive), tmp_path / "memory.db"
    replays(healthy, "--memory", memory)
    # WHEN the sensor is silent from the start
    code, (recording,) = replays(deaf, "--memory", memory)
    # THEN it is missed
    assert code == 1
    assert [d["code"] for d in recording["dtcs"]] == ["U0100"]
