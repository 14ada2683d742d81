"""What is attached to the live loop, and what it keeps to itself."""

from collections.abc import Callable
from pathlib import Path

import pytest

from monitor.base.types import Frame
from monitor.bus.loop import Loop
from monitor.frames.logs import read_frames
from monitor.frames.loop_frames import FIRST_ID, is_own, time_mark
from monitor.pipeline import replay
from monitor.pipeline.events import DtcChanged
from tests.helpers.bus.played_bus import Ear, PlayedBus, judged, played_on, run_on


def test_what_comes_from_the_bus_under_an_identifier_of_the_loop_is_refused(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    # GIVEN a node that says on the bus what only the loop may say
    foreign = [Frame(late_sensor[4000].t_ns, FIRST_ID + n, True, b"\x01") for n in range(3)]
    record = tmp_path / "foreign.log"
    live, _ = run_on([*late_sensor[:4000], *foreign, *late_sensor[4000:8000]], setup, record=record)
    # THEN nothing changes by it
    alone, _ = run_on(late_sensor[:8000], setup)
    assert judged(live) == judged(alone)
    mark, *frames = read_frames(record)
    assert mark == time_mark(late_sensor[0].t_ns)
    assert not any(is_own(frame) for frame in frames)


class Clearing(Ear):
    """An attachment that clears the codes when a certain frame comes."""

    clear: Callable[[], None]

    def receive(self, frame: Frame) -> None:
        self.clear()


def test_codes_that_a_tester_clears_are_cleared_in_a_replay_of_the_recording(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    # GIVEN a drive with a code, which is then cleared
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
    # THEN it was set and is gone
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
