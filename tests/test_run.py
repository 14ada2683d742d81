"""The live loop, on a bus that is played from memory; the real bus is in tests/vcan."""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import pytest
from cantools.database import load_file

import dbc
from monitor import config, replay
from monitor.clock import TIME_MARK_ID
from monitor.errors import RecordingError
from monitor.memory import Memory
from monitor.recorder import message_of
from monitor.run import Loop
from monitor.sources import read_frames
from monitor.transmit import Transmitter
from monitor.types import Frame

ROOT = Path(__file__).resolve().parent.parent


@dataclass
class Pause:
    """So many seconds of silence on the bus."""

    seconds: float


class PlayedBus(can.BusABC):
    """Gives messages as fast as they are asked for; its clock follows them."""

    def __init__(self, script: Iterable[Frame | Pause | can.Message]) -> None:
        super().__init__(channel="played")
        self._script = iter(script)
        self.channel_info = "played"
        self.now_s = 0.0
        self.sent: list[can.Message] = []
        self.stop = lambda: None

    def recv(self, timeout: float | None = None) -> can.Message | None:
        message, _ = self._recv_internal(timeout)
        if message is None or self._matches_filters(message):
            return message
        return self.recv(timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        item = self._pending if self._pending is not None else next(self._script, None)
        self._pending = None
        if item is None:
            self.stop()
            return None, False
        if isinstance(item, Pause):
            self.now_s += timeout or 0.0
            left_s = item.seconds - (timeout or 0.0)
            self._pending = Pause(left_s) if left_s > 0 else None
            return None, False
        return (message_of(item) if isinstance(item, Frame) else item), False

    _pending: Any = None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.sent.append(msg)


@pytest.fixture(scope="module")
def setup() -> replay.Setup:
    return replay.set_up(None, [], config.load())


@pytest.fixture(scope="module")
def late_sensor() -> list[Frame]:
    (log,) = ROOT.glob("replay_logs/delay_rich_to_lean_*.blf")
    return list(read_frames(log))[: 200 * 150]


def run_on(
    script: Iterable[Frame | Pause | can.Message],
    setup: replay.Setup,
    transmit: bool = False,
    **options: Any,
) -> tuple[dict[str, Any], PlayedBus]:
    bus = PlayedBus(script)
    with bus:
        loop = Loop(bus, setup, say=lambda _: None, monotonic_s=lambda: bus.now_s, **options)
        if transmit:
            loop.attachments.append(Transmitter(loop.pipeline.monitor))
        bus.stop = loop.stop
        loop.run()
    return loop.result("played"), bus


def judged(recording: dict[str, Any]) -> str:
    """Return what must not differ between a run and the replay of its recording."""
    keys = ("samples", "enabled_samples", "windows", "dtcs", "fault_flag", "completed", "enable")
    return json.dumps({key: recording[key] for key in keys})


@pytest.mark.parametrize("suffix", ["log", "blf"])
def test_a_replay_of_what_was_recorded_gives_the_same_events(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path, suffix: str
) -> None:
    record = tmp_path / f"drive.{suffix}"
    live, _ = run_on(late_sensor, setup, record=record)
    again, _ = replay.replay(record, setup)
    assert live["windows"]
    assert live["fault_flag"]
    assert judged(live) == judged(again)


def test_a_bus_that_falls_silent_is_missed_and_the_recording_says_so(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    # GIVEN a bus that falls silent for ten seconds and never comes back
    record = tmp_path / "silent.log"
    live, _ = run_on([*late_sensor[:4000], Pause(10.0)], setup, record=record)
    # THEN the lost communication is a code, while the bus is still silent
    assert [d["code"] for d in live["dtcs"]] == ["U0100"]
    # AND the recording holds the time marks that a replay needs to see it, too
    assert any(frame.can_id == TIME_MARK_ID for frame in read_frames(record))
    again, _ = replay.replay(record, setup)
    assert judged(live) == judged(again)


def test_error_frames_and_remote_frames_are_counted_and_survived(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    noise = [
        can.Message(timestamp=0.0, is_error_frame=True),
        can.Message(timestamp=0.0, is_remote_frame=True, arbitration_id=0xC2),
    ]
    script = [*late_sensor[:3000], *noise, *late_sensor[3000:6000]]
    live, _ = run_on(script, setup, record=tmp_path / "all.log")
    assert live["counters"]["skipped"] == 2
    assert live["samples"] > 250


def test_without_leave_nothing_is_sent_and_with_it_the_fault_flag_goes_out(
    setup: replay.Setup, late_sensor: list[Frame]
) -> None:
    _, silent = run_on(late_sensor[:2000], setup)
    assert silent.sent == []
    live, bus = run_on(late_sensor, setup, transmit=True)
    assert live["fault_flag"]
    database = load_file(dbc.path("o2_monitor.dbc"))
    status = [m for m in bus.sent if m.arbitration_id == 0x5C0]
    flags = [
        database.decode_message(m.arbitration_id, m.data, decode_choices=False)["FaultFlag"]
        for m in status
    ]
    assert flags[0] == 0
    assert flags[-1] == 1
    last = database.decode_message(0x5C0, status[-1].data, decode_choices=False)
    assert last["Dtc"] == 0x015A


def test_a_code_that_fails_again_in_the_next_driving_cycle_is_confirmed(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    states = []
    for _ in range(2):
        memory = Memory(tmp_path / "memory.db")
        live, _ = run_on(late_sensor, setup, memory=memory)
        memory.close()
        states.append({d["code"]: d["state"] for d in live["dtcs"]})
    assert states == [{"P015A": "pending"}, {"P015A": "confirmed"}]


def test_a_bus_on_which_nothing_was_ever_heard_is_missed_too(setup: replay.Setup) -> None:
    live, _ = run_on([Pause(60.0)], setup)
    assert [d["code"] for d in live["dtcs"]] == ["U0100"]


def test_frames_of_can_fd_are_recorded_as_they_came(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    long = [Frame(f.t_ns, 0x300, False, bytes(12)) for f in late_sensor[:5]]
    for suffix in ("log", "blf", "asc"):
        record = tmp_path / f"fd.{suffix}"
        run_on([*long, *late_sensor[5:50]], setup, record=record)
        frames = list(read_frames(record))
        assert len(frames) == 50
        assert frames[0].data == bytes(12)


def test_what_could_not_be_replayed_is_not_recorded(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    with pytest.raises(RecordingError, match=r"drive\.txt"):
        run_on(late_sensor[:10], setup, record=tmp_path / "drive.txt")


def test_a_run_of_days_keeps_the_latest_windows_and_says_how_many_it_dropped(
    setup: replay.Setup, late_sensor: list[Frame], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("monitor.run.KEEP", 3)
    live, _ = run_on(late_sensor, setup)
    assert len(live["windows"]) == 3
    assert live["windows_dropped"] == live["windows"][-1]["index"] + 1 - 3 > 0
