"""The monitor on a real SocketCAN bus: a recorded drive played into vcan0 at its own pace."""

import json
import statistics
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest

from monitor.frames.loop_frames import TIME_MARK_ID
from tests.vcan.guest import Finished

ROOT = Path(__file__).resolve().parents[2]
PLAY = ROOT / "tests" / "vcan" / "play_and_monitor.py"
STRETCH_S = 20.0
START_AND_END_S = 180.0  # boot, imports and shutdown, on one slow CPU that others use too
MEAN_TOLERANCE = 0.005  # lambda; a frame that jitter moves over a tick edge shifts a mean by less
SAME_WINDOW_S = 1.0  # two windows that start this close are of the same samples, or nearly

RunWithVcan = Callable[..., Finished]
Report = dict[str, Any]
Content = tuple[int, bool, bytes]  # identifier, whether it has 29 bits, payload


def test_every_frame_played_into_vcan_is_received_in_order_and_in_time(
    run_with_vcan: RunWithVcan, tmp_path: Path
) -> None:
    # GIVEN five seconds of a bus with 200 frames/s, with short, empty and 29-bit frames among them
    played = tmp_path / "played.log"
    write_log(played, [made_up_frame(number) for number in range(1000)])
    # WHEN it is played into vcan0 beside python-can's logger
    received = tmp_path / "received.log"
    logger = [sys.executable, "-m", "can.logger", "-i", "socketcan", "-c", "vcan0"]
    finished = play(run_with_vcan, played, [*logger, "-f", str(received)])
    # THEN the same frames come, in the same order
    assert finished.returncode == 0, finished.stdout
    assert contents(received) == contents(played)
    # AND at the same pace
    late_s = [there - here for here, there in zip(times_s(played), times_s(received), strict=True)]
    assert statistics.median(abs(late) for late in late_s) < 0.05
    assert abs(late_s[-1]) < 0.5


def test_the_exit_code_and_output_of_a_command_beside_vcan_come_back(
    run_with_vcan: RunWithVcan, tmp_path: Path
) -> None:
    command = ["sh", "-c", "cat /sys/class/net/vcan1/type; echo to stderr >&2; exit 3"]
    finished = run_with_vcan(command, tmp_path, timeout_s=START_AND_END_S, n_buses=2)
    assert finished.returncode == 3
    assert finished.stdout == "280\nto stderr\n"  # 280 is ARPHRD_CAN


def test_a_command_beside_vcan_that_hangs_is_ended(
    run_with_vcan: RunWithVcan, tmp_path: Path
) -> None:
    with pytest.raises(subprocess.TimeoutExpired):
        run_with_vcan(["sleep", "1000"], tmp_path, timeout_s=1.0)


def test_a_faulty_drive_on_the_bus_is_judged_as_its_recording_is(
    run_with_vcan: RunWithVcan, tmp_path: Path
) -> None:
    # GIVEN the stretch of a drive in which most is judged
    log = recording_of("delay_rich_to_lean")
    start_s = busiest_start_s(replay(log, tmp_path / "whole.json"))
    played, recorded = tmp_path / "played.log", tmp_path / "recorded.log"
    write_log(played, stretch(log, start_s, STRETCH_S))
    # WHEN it is played into vcan0 while the monitor listens and records
    report = tmp_path / "run.json"
    monitor = [sys.executable, "-m", "monitor.cli", "run", "-i", "socketcan", "-c", "vcan0"]
    outputs = ["--record", str(recorded), "--json", str(report)]
    limit = ["--duration", str(STRETCH_S + START_AND_END_S)]  # it is interrupted before
    finished = play(run_with_vcan, played, [*monitor, *outputs, *limit])
    assert finished.returncode in {0, 1, 3}, finished.stdout
    live = only_recording(report)
    # THEN no frame was lost, and what was recorded replays to exactly what the monitor said
    assert without_time_marks(contents(recorded)) == contents(played)
    again = replay(recorded, tmp_path / "again.json")
    assert live["windows"], "nothing was judged, so nothing was compared"
    assert live["windows"] == again["windows"]
    assert live["dtcs"] == again["dtcs"]
    # AND the drive itself replays to the same codes and, but for jitter, the same windows
    original = replay(played, tmp_path / "original.json")
    assert codes(live) == codes(original)
    assert abs(len(live["windows"]) - len(original["windows"])) <= 1
    pairs = same_windows(live, original, silent_s(recorded))
    assert len(pairs) >= len(original["windows"]) - 1
    for here, there in pairs:
        assert here["mean"] == pytest.approx(there["mean"], abs=MEAN_TOLERANCE)


def play(run_with_vcan: RunWithVcan, log: Path, listener: list[str]) -> Finished:
    """Play ``log`` into vcan0 while ``listener`` runs."""
    command = [sys.executable, str(PLAY), str(log), "--", *listener]
    timeout_s = times_s(log)[-1] + START_AND_END_S
    return run_with_vcan(command, ROOT, timeout_s=timeout_s)


def replay(log: Path, report: Path) -> Report:
    """Replay ``log`` with all defaults; return its part of the JSON report."""
    command = [sys.executable, "-m", "monitor.cli", "replay", str(log), "--json", str(report)]
    finished = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert finished.returncode in {0, 1, 3}, finished.stderr
    return only_recording(report)


def only_recording(report: Path) -> Report:
    (recording,) = json.loads(report.read_text(encoding="utf-8"))["recordings"]
    return dict(recording)


def codes(recording: Report) -> list[tuple[str, str, str]]:
    return [(dtc["code"], dtc["fault"], dtc["state"]) for dtc in recording["dtcs"]]


def silent_s(recorded: Path) -> float:
    """Return how long the monitor marked the time before the first frame came."""
    with can.LogReader(recorded) as reader:
        frames = list(reader)
    heard = next(f.timestamp for f in frames if f.arbitration_id != TIME_MARK_ID)
    return float(heard - frames[0].timestamp)


def same_windows(live: Report, original: Report, silent_s: float) -> list[tuple[Report, Report]]:
    """Return the pairs of windows that begin at about the same time."""
    return [
        (here, there)
        for there in original["windows"]
        for here in live["windows"]
        if abs(here["t_start_s"] - silent_s - there["t_start_s"]) < SAME_WINDOW_S
    ]


def recording_of(drive: str) -> Path:
    """Return the first log of ``drive`` in replay_logs/."""
    logs = [
        log
        for log in sorted((ROOT / "replay_logs").glob(f"{drive}_*"))
        if log.suffix in {".blf", ".log", ".asc"}
    ]
    assert logs, f"replay_logs/ has no log of {drive}"
    return logs[0]


def busiest_start_s(whole: Report) -> float:
    """Return from where on most windows of a recording lie within STRETCH_S."""
    starts_s = [window["t_start_s"] for window in whole["windows"]]
    assert starts_s, f"{whole['path']}: no window"

    def n_from(start_s: float) -> int:
        return sum(start_s <= other_s < start_s + STRETCH_S for other_s in starts_s)

    return float(max(starts_s, key=n_from))


def stretch(log: Path, start_s: float, length_s: float) -> list[can.Message]:
    """Return the frames of ``log`` from ``start_s`` after its first one on."""
    with can.LogReader(log) as reader:
        frames = list(reader)
    first_s = frames[0].timestamp + start_s
    cut = [frame for frame in frames if first_s <= frame.timestamp < first_s + length_s]
    assert cut, f"{log} has no frames from {start_s} s on"
    return cut


def write_log(path: Path, frames: list[can.Message]) -> None:
    with can.CanutilsLogWriter(path) as writer:
        for frame in frames:
            frame.channel = "vcan0"
            writer.on_message_received(frame)


def made_up_frame(number: int) -> can.Message:
    payload = bytes((number * step) & 0xFF for step in range(1, 1 + number % 9))
    extended = number % 10 == 0
    return can.Message(
        timestamp=1000.0 + number / 200.0 + 0.001 * (number % 3),
        arbitration_id=0x18FF0000 + number if extended else 0x100 + number % 64,
        is_extended_id=extended,
        data=payload,
    )


def contents(log: Path) -> list[Content]:
    """Return what every frame of a log carries, in order."""
    with can.LogReader(log) as reader:
        return [(frame.arbitration_id, frame.is_extended_id, bytes(frame.data)) for frame in reader]


def without_time_marks(frames: list[Content]) -> list[Content]:
    """Leave out the frames with which the monitor records that time passed on a silent bus."""
    return [frame for frame in frames if frame[0] != TIME_MARK_ID]


def times_s(log: Path) -> list[float]:
    """Return the frames' times since the first one."""
    with can.LogReader(log) as reader:
        times = [frame.timestamp for frame in reader]
    return [time - times[0] for time in times]
