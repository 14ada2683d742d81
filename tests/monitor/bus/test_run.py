"""The live loop and what is attached to it, on a played bus; the real bus is in tests/vcan."""

import threading
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import can
import pytest
from cantools.database import load_file

import dbc
from monitor.base.errors import RecordingError
from monitor.base.types import Frame, FrameBlock
from monitor.bus.link.recorder import Recorder
from monitor.bus.loop import Loop
from monitor.frames.blocks import block_of
from monitor.frames.logs import read_frames
from monitor.frames.loop_frames import FIRST_ID, TIME_MARK_ID, is_own, time_mark
from monitor.memory.store import Memory
from monitor.pipeline import replay
from monitor.pipeline.events import DtcChanged, Event
from tests.helpers.bus.played_bus import Ear, Pause, PlayedBus, judged, played_on, run_on


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
    status = [m.data for m in bus.sent if m.arbitration_id == 0x5C0]
    told = [database.decode_message(0x5C0, data, decode_choices=False) for data in status]
    assert (told[0]["FaultFlag"], told[-1]["FaultFlag"], told[-1]["Dtc"]) == (0, 1, 0x015A)


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
        mark, *frames = read_frames(record)
        assert mark == time_mark(frames[0].t_ns)
        assert (len(frames), frames[0].data) == (50, bytes(12))


def test_what_could_not_be_replayed_is_not_recorded(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    with pytest.raises(RecordingError, match=r"drive\.txt"):
        run_on(late_sensor[:10], setup, record=tmp_path / "drive.txt")
    with pytest.raises(RecordingError, match="no CAN FD"), Recorder(tmp_path / "fd.trc") as log:
        log.write(block_of([Frame(0, 0x300, False, bytes(12))]))


def test_a_run_of_days_keeps_the_latest_windows_and_says_how_many_it_dropped(
    setup: replay.Setup, late_sensor: list[Frame], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("monitor.bus.judging.KEEP", 3)
    live, _ = run_on(late_sensor, setup)
    assert len(live["windows"]) == 3
    assert live["windows_dropped"] == live["windows"][-1]["index"] + 1 - 3 > 0


def bus_off(t_ns: int) -> can.Message:
    return can.Message(t_ns / 1e9, arbitration_id=0x40, is_error_frame=True, data=bytes(8))


SILENT: dict[str, tuple[Callable[[list[Frame]], list[Any]], str]] = {
    "the bus": (lambda drive: [*drive[:4000], Pause(10.0)], "U0100"),
    "the sensor": (lambda drive: [frame for frame in drive if frame.can_id != 0xC2], "U0100"),
    "the monitor's own controller": (
        lambda drive: [*drive[:4000], bus_off(drive[4000].t_ns), Pause(10.0)],
        "U0001",
    ),
    "the ECU on a bus that came back": (
        lambda drive: [
            *(*drive[:4000], bus_off(0), Pause(1.0)),
            *(Frame(drive[3999].t_ns + 1_000_000_000, 0x7A0, False, b""), Pause(10.0)),
        ],
        "U0100",
    ),
}


@pytest.mark.parametrize("who", SILENT)
def test_whoever_is_silent_is_blamed_live_and_in_a_replay_of_the_recording(
    who: str, setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    # GIVEN a drive in which somebody falls silent, or is off the bus
    script, code = SILENT[who]
    record = tmp_path / "silent.log"
    # WHEN it is judged THEN there is its code, while the silence lasts
    live, _ = run_on(script(late_sensor), setup, record=record)
    assert [d["code"] for d in live["dtcs"]] == [code]
    # AND the recording holds the time marks that a replay needs to see it, too
    assert any(frame.can_id == TIME_MARK_ID for frame in read_frames(record))
    again, _ = replay.replay(record, setup)
    assert judged(live) == judged(again)


class FullDisk(Memory):
    """A fault memory that cannot be written for its first two tries."""

    tries_left = 2

    def save(self, saved: Any) -> None:
        self.tries_left -= 1
        if self.tries_left >= 0:
            raise RecordingError("o2.db: cannot store the fault memory: disk is full")
        super().save(saved)


def test_a_memory_that_cannot_be_written_is_told_once_and_all_is_stored_before_the_views_close(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    said, stored, memory, view = list[str](), list[Any](), FullDisk(tmp_path / "o2.db"), Ear()
    view.close = lambda: stored.append(memory.load())  # type: ignore[method-assign]
    loop, _ = played_on(late_sensor, setup, memory=memory, say=said.append, attachments=[view])
    assert "P015A" in [d["code"] for d in loop.result("played")["dtcs"]]
    assert loop.health.memory_errors == 2
    assert len([line for line in said if "disk is full" in line]) == 1
    # AND once there is room again, what was not stored is
    assert "P015A" in {d.code for d in memory.load().dtcs if d.state}
    assert stored == [memory.load()]
    memory.close()


def test_codes_that_are_not_stored_by_the_end_are_not_kept_secret(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    said = list[str]()
    with closing(FullDisk(tmp_path / "o2.db")) as memory:
        memory.tries_left = 1_000_000
        played_on(late_sensor, setup, memory=memory, say=said.append)
    assert said[-1].endswith("they could not be stored")


def test_a_log_that_cannot_be_written_any_more_ends_and_the_judging_goes_on(
    setup: replay.Setup, late_sensor: list[Frame]
) -> None:
    said, record = list[str](), Path("/dev/full")
    if not record.exists():
        pytest.skip("no /dev/full")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("monitor.bus.link.recorder.log_kind", lambda path: ".log")
        patch.setattr("monitor.bus.link.recorder.can.Logger", can.CanutilsLogWriter)
        loop, _ = played_on(late_sensor[:4000], setup, record=record, say=said.append)
    assert loop.result("played")["samples"] > 190
    assert len([line for line in said if "No space left" in line]) == 1


def test_a_disk_that_stalls_delays_no_verdict_and_loses_no_frame(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Released(Ear):
        def push(self, event: Event) -> None:
            judged_before.set()

    judged_before, in_time, write = threading.Event(), list[bool](), Recorder.write

    def stalling(self: Recorder, block: FrameBlock) -> None:
        in_time.append(judged_before.wait(20.0))
        write(self, block)

    monkeypatch.setattr(Recorder, "write", stalling)
    script, record = late_sensor[:2000], tmp_path / "all.log"
    played_on(script, setup, record=record, attachments=[Released()])
    assert all(in_time)
    assert [f.data for f in read_frames(record) if f.can_id < TIME_MARK_ID] == [
        f.data for f in script
    ]


def test_a_drive_goes_on_after_the_interface_was_away(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    # GIVEN an interface that goes away for twenty seconds in the middle of a drive
    gap_s, n = 20.0, 6_000
    later = [f._replace(t_ns=f.t_ns + round(gap_s * 1e9)) for f in late_sensor[n:]]
    down = can.CanOperationError("Network is down", 100)
    first, second = PlayedBus([*late_sensor[:n], down]), PlayedBus(later)
    now = [0.0]

    def reopen() -> can.BusABC:
        if now[0] < gap_s:
            raise OSError(19, "No such device")
        return second

    def sleep(seconds: float) -> None:
        now[0] += seconds

    record = tmp_path / "gap.log"
    clock = {"monotonic_s": lambda: now[0], "sleep": sleep, "say": lambda _: None}
    loop = Loop(first, setup, reopen=reopen, record=record, **clock)
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


def test_what_comes_from_the_bus_under_an_identifier_of_the_loop_is_refused(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    # GIVEN a node that says on the bus what only the loop may say
    foreign = [Frame(late_sensor[4000].t_ns, FIRST_ID + n, True, b"\x01") for n in range(3)]
    record = tmp_path / "foreign.log"
    live, _ = run_on([*late_sensor[:4000], *foreign, *late_sensor[4000:8000]], setup, record=record)
    alone, _ = run_on(late_sensor[:8000], setup)
    assert judged(live) == judged(alone)
    mark, *frames = read_frames(record)
    assert mark == time_mark(late_sensor[0].t_ns)
    assert not any(is_own(frame) for frame in frames)


class Clearing(Ear):
    clear: Callable[[], None]

    def receive(self, frame: Frame) -> None:
        self.clear()


def test_codes_that_a_tester_clears_are_cleared_in_a_replay_of_the_recording(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    record = tmp_path / "cleared.log"
    asked = Frame(late_sensor[-1].t_ns, 0x6F0, False, b"")
    tester = Clearing()
    bus = PlayedBus([*late_sensor, asked])
    with bus:
        quiet = {"say": lambda _: None, "monotonic_s": lambda: bus.now_s}
        loop = Loop(bus, setup, record=record, attachments=[tester], **quiet)
        tester.clear, bus.stop = loop.clear_codes, loop.stop
        loop.run()
    live = loop.result("played")
    states = [e.dtc.state for e in tester.events if isinstance(e, DtcChanged)]
    assert "pending" in states
    assert live["dtcs"] == []
    # AND so it is in a replay
    again, _ = replay.replay(record, setup)
    assert judged(live) == judged(again)


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
    script = [*late_sensor[:100], asked, *late_sensor[100:2000]]
    loop, _ = played_on(script, setup, attachments=[bad, good], say=said.append)
    assert loop.result("played")["samples"] > 90
    assert len(good.events) > 90
    assert good.heard == [asked]
    assert (bad.closed, good.closed) == (1, 1)
    assert loop.health.detached == (where != "close")
    assert [line for line in said if f"no more {where}" in line] == said
    assert len(said) == 1
