"""A mapped message that never came: the map may be wrong, so the vehicle is not blamed."""

from pathlib import Path

import can
import pytest

import dbc
from monitor import cli
from monitor.base.types import Frame
from monitor.decode.bus_map import load_pairs
from monitor.frames.logs import read_frames
from tests.conftest import ROOT
from tests.helpers.logs.replays import replays

ECU = load_pairs([(dbc.path("o2_ecu.dbc"), dbc.path("o2_ecu.toml"))])


@pytest.fixture(scope="module")
def drive() -> list[Frame]:
    """Give two minutes of a healthy drive."""
    (log,) = ROOT.glob("replay_logs/healthy_micro_*.blf")
    frames = list(read_frames(log))
    return [f for f in frames if f.t_ns < frames[0].t_ns + 120_000_000_000]


@pytest.fixture
def deaf(drive: list[Frame], tmp_path: Path) -> Path:
    """Give the drive without the message of the sensor."""
    lambda_id = ECU.channels["lambda_measured"].message.frame_id
    return written(tmp_path / "deaf.blf", [f for f in drive if f.can_id != lambda_id])


def written(path: Path, frames: list[Frame]) -> Path:
    with can.BLFWriter(path) as writer:
        for frame in frames:
            writer.on_message_received(
                can.Message(
                    timestamp=frame.t_ns / 1e9,
                    arbitration_id=frame.can_id,
                    is_extended_id=frame.is_extended,
                    data=frame.data,
                )
            )
    return path


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
    healthy, memory = written(tmp_path / "healthy.blf", drive), tmp_path / "memory.db"
    replays(healthy, "--memory", memory)
    # WHEN the sensor is silent from the start
    code, (recording,) = replays(deaf, "--memory", memory)
    # THEN it is missed
    assert code == 1
    assert [d["code"] for d in recording["dtcs"]] == ["U0100"]


def test_a_log_without_any_mapped_frame_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = written(tmp_path / "other.blf", [Frame(k * 10**8, 0x7A0, False, b"") for k in range(600)])
    assert cli.main(["replay", str(log)]) == 2
    assert "none of its 600 frames is one of" in capsys.readouterr().err
