"""Bad frames and gaps in a log are counted and survived."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from monitor.base import faults
from monitor.base.types import Frame
from monitor.frames.logs import read_frames
from monitor.inject.gateway import write_log
from tests.helpers.logs.injected_frames import FUEL_ID, LAMBDA_ID
from tests.helpers.logs.replays import replays
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment

Change = Callable[[list[Frame]], list[Frame]]


def replayed(drive: Path, tmp_path: Path, change: Change) -> dict[str, Any]:
    """Return the result on a log whose frames were changed; the replay must survive it."""
    log = tmp_path / "changed.log"
    write_log(log, change(list(read_frames(drive))))
    code, (recording,) = replays(log)
    assert code in (0, 1, 3)
    return recording


def test_a_stuck_counter_is_counted_and_the_message_counts_as_missing(
    ninety_seconds: Path, tmp_path: Path
) -> None:
    # GIVEN an ECU that repeats one lambda frame for ever, its checksum still right
    def freeze(frames: list[Frame]) -> list[Frame]:
        first = next(f for f in frames if f.can_id == LAMBDA_ID)
        return [f._replace(data=first.data) if f.can_id == LAMBDA_ID else f for f in frames]

    recording = replayed(ninety_seconds, tmp_path, freeze)
    assert recording["counters"]["stuck"] > 4400
    assert [d["code"] for d in recording["dtcs"]] == ["U0100"]


def test_a_message_that_stops_blocks_and_is_counted(ninety_seconds: Path, tmp_path: Path) -> None:
    def stop(frames: list[Frame]) -> list[Frame]:
        end = frames[0].t_ns + 40_000_000_000
        return [f for f in frames if f.can_id != FUEL_ID or f.t_ns < end]

    recording = replayed(ninety_seconds, tmp_path, stop)
    assert recording["enable"]["inputs_valid"] == pytest.approx(40.3 / 90, abs=0.01)
    assert recording["dtcs"] == []  # the fuel message is not the sensor's fault


def test_a_short_drive_does_not_heal_a_sensor_that_never_gets_ready(tmp_path: Path) -> None:
    # GIVEN a sensor that never gets ready and drives that are shorter than the patience
    fault = faults.resolve("not_ready")
    short = Experiment(cycle="micro_trips", vehicle=51, seed=51, duration_s=40.0, fault=fault)
    long = Experiment(cycle="micro_trips", vehicle=51, seed=52, duration_s=90.0, fault=fault)
    logs = [write(e, tmp_path, "log") for e in (long, short, short, short, short)]
    # WHEN they follow the drive in which it was found
    _, recordings = replays(*logs, "--memory", tmp_path / "m.db")
    # THEN the code stays
    assert [[d["code"] for d in r["dtcs"]] for r in recordings] == [["P0134"]] * 5
