"""The example on a CAN bus sends what the live loop sends, frame for frame."""

import random
import shutil
from pathlib import Path

import can
import pytest

from monitor.decode.checksum import payload_checksum
from monitor.pipeline.replay import Setup
from tests.helpers.bus import on_can
from tests.helpers.bus.played_bus import played_on
from tests.helpers.logs.replays import replay_log

LAMBDA_ID = 0xC2
pytestmark = pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc")


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return on_can.compiled_in(tmp_path_factory.mktemp("on_can"))


@pytest.mark.parametrize("fault", ["out_of_range", "signal_missing", "delay_rich_to_lean"])
def test_it_sends_the_status_frames_of_the_live_loop_on_a_faulty_drive(
    fault: str, setup: Setup, program: Path
) -> None:
    frames = drive(fault, 70.0)
    sent = statuses_of_the_loop(frames, setup)
    assert on_can.first_flag(sent), "the drive sets no flag, so nothing is compared"
    assert on_can.statuses(program, frames) == sent


def test_broken_frames_late_frames_and_pauses_do_to_it_what_they_do_to_the_live_loop(
    setup: Setup, program: Path
) -> None:
    # GIVEN a drive with wrong checksums, counters that stand, values that are not available or out
    # of range, frames that come late, and pauses of which one is longer than the grid bears
    frames = damaged(drive("delay_rich_to_lean", 60.0))
    sent = statuses_of_the_loop(frames, setup)
    assert on_can.first_flag(sent), "the drive sets no flag, so none is compared"
    # THEN both say the same of every sample
    said = on_can.statuses(program, frames)
    assert [on_can.without_share(payload) for payload in said] == [
        on_can.without_share(p) for p in sent
    ]


def drive(fault: str, length_s: float) -> list[can.Message]:
    """Return the begin of a replay log, times in whole microseconds as a log has them."""
    with can.LogReader(replay_log(f"{fault}_micro_trips")) as reader:
        frames = list(reader)
    for frame in frames:
        frame.timestamp = round(frame.timestamp, 6)
    end_s = frames[0].timestamp + length_s
    found = [frame for frame in frames if frame.timestamp < end_s]
    found[-1].timestamp = round(end_s, 6)  # at the very end of a tick, which it does not close
    return found


def statuses_of_the_loop(frames: list[can.Message], setup: Setup) -> list[bytes]:
    _, bus = played_on(frames, setup, transmit=True)
    return [bytes(frame.data) for frame in bus.sent if frame.arbitration_id == on_can.STATUS_ID]


def damaged(frames: list[can.Message]) -> list[can.Message]:
    rng, found, shift_s, last = random.Random(1), list[can.Message](), 0.0, bytearray()
    for k, frame in enumerate(frames):
        shift_s += {4000: 0.45, 7000: 3.0, 10000: 70.0}.get(k, 0.0)
        frame.timestamp = round(frame.timestamp + shift_s, 6)
        chance = rng.random()
        if chance < 0.02:
            frame.data[rng.randrange(8)] ^= 1 << rng.randrange(8)
        elif chance < 0.04:
            found.append(frame)
        elif chance < 0.06:
            frame.timestamp = round(frame.timestamp - rng.uniform(0.0, 0.2), 6)
        elif chance < 0.08 or (frame.arbitration_id == LAMBDA_ID and 2000 < k < 2200):
            frame.data[:4] = b"\xff\xff\xff\xff" if k % 2 else bytes(4)
            own = "crc8_sae_j1850_id", frame.arbitration_id, bytes(frame.data), 7
            frame.data[7] = payload_checksum(*own)
        if frame.arbitration_id == LAMBDA_ID:
            if 5000 < k < 5600:  # its counter stands
                frame.data = last
            last = bytearray(frame.data)
            if 8000 < k < 8600:  # its checksum is wrong
                frame.data[7] ^= 1
        found.append(frame)
    return found
