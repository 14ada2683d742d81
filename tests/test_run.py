"""The live loop, on a bus that is played from memory; the real bus is in tests/vcan."""

import json
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import pytest
from cantools.database import load_file

import dbc
from monitor import config, replay
from monitor.bus.recorder import message_of
from monitor.errors import RecordingError
from monitor.memory import Memory
from monitor.own_frames import FIRST_ID, TIME_MARK_ID, is_own
from monitor.pipeline import DtcChanged, Event
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
        self.channel_info = "socketcan channel 'played'"
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


def bus_off(t_ns: int) -> can.Message:
    return can.Message(
        timestamp=t_ns / 1e9, arbitration_id=0x40, is_error_frame=True, data=bytes(8)
    )


def test_while_the_monitor_itself_is_off_the_bus_no_sender_is_blamed(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    # GIVEN a bus on which the monitor's own controller goes off and stays off
    record = tmp_path / "off.log"
    script = [*late_sensor[:4000], bus_off(late_sensor[4000].t_ns), Pause(10.0)]
    live, _ = run_on(script, setup, record=record)
    # THEN the code is that of its own communication
    assert [d["code"] for d in live["dtcs"]] == ["U0001"]
    # AND the recording says so, too
    again, _ = replay.replay(record, setup)
    assert judged(live) == judged(again)


def test_after_the_bus_came_back_a_sender_that_stays_away_is_not_excused(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    record = tmp_path / "back.log"
    stranger = Frame(late_sensor[3999].t_ns + 1_000_000_000, 0x7A0, False, b"")
    script = [*late_sensor[:4000], bus_off(0), Pause(1.0), stranger, Pause(10.0)]
    live, _ = run_on(script, setup, record=record)
    assert [d["code"] for d in live["dtcs"]] == ["U0100"]
    again, _ = replay.replay(record, setup)
    assert judged(live) == judged(again)


@pytest.mark.parametrize("number", range(FIRST_ID, FIRST_ID + 3))
def test_what_comes_from_the_bus_under_an_identifier_of_the_loop_is_refused(
    number: int, setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    # GIVEN a node that says on the bus what only the loop may say
    foreign = Frame(late_sensor[4000].t_ns, number, True, b"\x01")
    record = tmp_path / "foreign.log"
    live, _ = run_on([*late_sensor[:4000], foreign, *late_sensor[4000:8000]], setup, record=record)
    # THEN nothing changes by it
    alone, _ = run_on(late_sensor[:8000], setup)
    assert judged(live) == judged(alone)
    assert not any(is_own(frame) for frame in read_frames(record))


class Clearing:
    """An attachment that clears the codes when a certain frame comes."""

    identifiers = ((0x6F0, False),)
    due_s = math.inf

    def __init__(self) -> None:
        self.clear: Callable[[], None] = lambda: None
        self.events: list[Event] = []

    def receive(self, frame: Frame) -> list[Frame]:
        self.clear()
        return []

    def push(self, event: Event) -> None:
        self.events.append(event)

    def work(self, now_s: float) -> list[Frame]:
        return []

    def close(self) -> None:
        pass


def test_codes_that_a_tester_clears_are_cleared_in_a_replay_of_the_recording(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    # GIVEN a drive with a code, which is then cleared
    record = tmp_path / "cleared.log"
    asked = Frame(late_sensor[-1].t_ns, 0x6F0, False, b"")
    tester = Clearing()
    bus = PlayedBus([*late_sensor, asked])
    with bus:
        loop = Loop(bus, setup, record=record, attachments=[tester], say=lambda _: None,
                    monotonic_s=lambda: bus.now_s)  # fmt: skip
        tester.clear, bus.stop = loop.clear_codes, loop.stop
        loop.run()
    live = loop.result("played")
    # THEN it was set and is gone
    states = [e.dtc.state for e in tester.events if isinstance(e, DtcChanged)]
    assert "pending" in states
    assert live["dtcs"] == []
    # AND so it is in a replay
    again, _ = replay.replay(record, setup)
    assert judged(live) == judged(again)


class Ear:
    """An attachment that keeps what it is given, and answers one identifier."""

    identifiers = ((0x6F0, False),)

    @property
    def due_s(self) -> float:
        self._maybe_fail("due")
        return float("inf")

    def __init__(self, answer: Iterable[Frame] = (), fails_at: str = "") -> None:
        self.answer, self.fails_at = list(answer), fails_at
        self.heard: list[Frame] = []
        self.events: list[Any] = []
        self.worked = self.closed = 0

    def _maybe_fail(self, where: str) -> None:
        if where == self.fails_at:
            raise RuntimeError(f"no more {where}")

    def receive(self, frame: Frame) -> list[Frame]:
        self._maybe_fail("receive")
        self.heard.append(frame)
        answer, self.answer = self.answer, []
        return answer

    def push(self, event: Any) -> None:
        self._maybe_fail("push")
        self.events.append(event)

    def work(self, now_s: float) -> list[Frame]:
        self._maybe_fail("work")
        self.worked += 1
        return []

    def close(self) -> None:
        self.closed += 1
        self._maybe_fail("close")


def test_what_an_attachment_makes_of_a_frame_is_recorded_and_judged(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    # GIVEN an attachment that, asked, knows what the next thousand frames were
    record = tmp_path / "made.log"
    begin, rest = late_sensor[:1000], late_sensor[1000:2000]
    ear = Ear(answer=rest)
    asked = Frame(rest[0].t_ns, 0x6F0, False, b"")
    live, bus = run_on([*begin, asked], setup, record=record, attachments=[ear])
    # THEN these are judged like received ones, and stand in the log
    assert ear.heard == [asked]
    assert live["samples"] > 90
    again, _ = replay.replay(record, setup)
    assert judged(live) == judged(again)
    assert (ear.closed, bus.sent) == (1, [])


def test_the_filters_are_what_is_judged_and_what_is_attached(
    setup: replay.Setup, late_sensor: list[Frame]
) -> None:
    _, bus = run_on(late_sensor[:10], setup, attachments=[Ear()])
    assert bus.filters is not None
    wanted = {(f["can_id"], f["extended"]) for f in bus.filters}
    assert (0x6F0, False) in wanted
    assert len(wanted) > 5


@pytest.mark.parametrize("where", ["receive", "push", "work", "due", "close"])
def test_an_attachment_that_raises_is_let_go_and_the_judging_goes_on(
    where: str, setup: replay.Setup, late_sensor: list[Frame]
) -> None:
    bad, good, said = Ear(fails_at=where), Ear(), []
    asked = Frame(late_sensor[100].t_ns, 0x6F0, False, b"")
    bus = PlayedBus([*late_sensor[:100], asked, *late_sensor[100:2000]])
    with bus:
        loop = Loop(
            bus, setup, attachments=[bad, good], say=said.append, monotonic_s=lambda: bus.now_s
        )
        bus.stop = loop.stop
        loop.run()
    assert loop.result("played")["samples"] > 90
    assert len(good.events) > 90
    assert good.heard == [asked]
    assert (bad.closed, good.closed) == (1, 1)
    assert loop.health.detached == (where != "close")
    assert [line for line in said if f"no more {where}" in line] == said
    assert len(said) == 1


class FullDisk(Memory):
    """A fault memory that cannot be written for its first so many tries."""

    def __init__(self, path: Path, tries: int) -> None:
        super().__init__(path)
        self.tries_left = tries

    def save(self, saved: Any) -> None:
        self.tries_left -= 1
        if self.tries_left >= 0:
            raise RecordingError("o2.db: cannot store the fault memory: disk is full")
        super().save(saved)


@pytest.mark.parametrize("tries", [2, 1_000_000])
def test_a_memory_that_cannot_be_written_is_told_once_and_the_judging_goes_on(
    tries: int, setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    said: list[str] = []
    memory = FullDisk(tmp_path / "o2.db", tries)
    bus = PlayedBus([*late_sensor, Pause(30.0)])
    with bus:
        loop = Loop(bus, setup, memory=memory, say=said.append, monotonic_s=lambda: bus.now_s)
        bus.stop = loop.stop
        loop.run()
    assert "P015A" in [d["code"] for d in loop.result("played")["dtcs"]]
    assert loop.health.memory_errors >= 2
    assert len([line for line in said if "disk is full" in line]) == 1
    # AND once there is room again, what was not stored is
    stored = {d.code for d in memory.load().dtcs if d.state}
    assert ("P015A" in stored) == (tries == 2)
    memory.close()


def test_a_log_that_cannot_be_written_any_more_ends_and_the_judging_goes_on(
    setup: replay.Setup, late_sensor: list[Frame]
) -> None:
    said: list[str] = []
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full")
    record = Path("/dev/full")
    bus = PlayedBus(late_sensor)
    with bus, pytest.MonkeyPatch.context() as patch:
        patch.setattr("monitor.bus.recorder.log_kind", lambda path: ".log")
        patch.setattr("monitor.bus.recorder.can.Logger", can.CanutilsLogWriter)
        loop = Loop(bus, setup, record=record, say=said.append, monotonic_s=lambda: bus.now_s)
        bus.stop = loop.stop
        loop.run()
    assert loop.result("played")["fault_flag"]
    assert len([line for line in said if "No space left" in line]) == 1


class GoneBus(PlayedBus):
    """A played bus that fails where its script ends."""

    def recv(self, timeout: float | None = None) -> can.Message | None:
        message = super().recv(timeout)
        if message is None and self._pending is None:
            raise can.CanOperationError("Network is down", 100)
        return message


def test_a_drive_goes_on_after_the_interface_was_away(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    # GIVEN an interface that goes away for twenty seconds in the middle of a drive
    gap_s, n = 20.0, 15_000
    later = [f._replace(t_ns=f.t_ns + round(gap_s * 1e9)) for f in late_sensor[n:]]
    first, second = GoneBus(late_sensor[:n]), PlayedBus(later)
    said: list[str] = []
    now = [0.0]

    def reopen() -> can.BusABC:
        if now[0] < gap_s:
            raise OSError(19, "No such device")
        return second

    def sleep(seconds: float) -> None:
        now[0] += seconds

    record = tmp_path / "gap.log"
    loop = Loop(
        first, setup, reopen=reopen, record=record, say=said.append,
        monotonic_s=lambda: now[0], sleep=sleep,
    )  # fmt: skip
    second.stop = loop.stop
    loop.run()
    live = loop.result("played")
    # THEN it is the monitor's own communication that failed, and the sensor is judged before and
    # after; the recording replays to the same
    codes = {d["code"] for d in live["dtcs"]}
    assert "U0001" in codes
    assert "U0100" not in codes
    assert live["windows"][-1]["t_start_s"] > n / 200 + gap_s
    assert (loop.health.losses, loop.health.reconnects) == (1, 1)
    again, _ = replay.replay(record, setup)
    assert judged(live) == judged(again)
