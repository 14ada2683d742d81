"""Bus time of the live loop: a frame's time is measured against a monotonic clock."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.damage.fuzz_times import (
    BEGIN_NS,
    Arriving,
    Listening,
    S,
    arrivals,
    healthy,
    jumping,
    lived,
)
from monitor.base import config
from monitor.base.types import Frame
from monitor.bus.link.clock import AGREEING, Clock
from monitor.bus.loop import Loop
from monitor.frames.blocks import block_of, chosen, frames_of, joined
from monitor.frames.logs import read_frames
from monitor.frames.loop_frames import is_own
from monitor.grid.block_assembler import LATEST_NS
from monitor.pipeline import replay
from tests.helpers.bus.played_bus import judged
from tests.helpers.logs.batch_logs import MS

SETUP = replay.set_up(None, (), config.load())
DRIVE = healthy(28.0)
MIDDLE = len(DRIVE.t_ns) // 2
TRUE_S = (DRIVE.t_ns - BEGIN_NS) / S
PAUSE_NS = 300 * MS


def paused(pause_s: float, step_s: float, record: Path) -> dict[str, Any]:
    """Return what a run says of a drive with a pause, its clock set meanwhile by so much."""
    rest = chosen(DRIVE, slice(MIDDLE, None))
    rest = rest._replace(t_ns=rest.t_ns + round((pause_s + step_s) * S))
    arrivals_s = np.concatenate([TRUE_S[:MIDDLE], TRUE_S[MIDDLE:] + pause_s])
    bus = Arriving(joined([chosen(DRIVE, slice(0, MIDDLE)), rest]), arrivals_s.tolist())
    with bus:
        loop = Loop(bus, SETUP, record=record, say=lambda _: None, monotonic_s=lambda: bus.now_s)
        bus.loop = loop
        loop.run()
    return loop.result("paused")


@pytest.mark.parametrize("step_s", [0.0, 3600.0])
def test_a_bus_that_is_silent_by_the_monotonic_clock_is_missed_whatever_its_counters_say(
    step_s: float, tmp_path: Path
) -> None:
    # GIVEN a bus that is silent for five seconds and then goes on as if nothing had been,
    # its clock set meanwhile or not
    record = tmp_path / "silent.log"
    live = paused(5.0, step_s, record)
    # THEN the lost communication is a code, in the run and in the replay of its recording
    assert [dtc["code"] for dtc in live["dtcs"]] == ["U0100"]
    again, _ = replay.replay(record, SETUP)
    assert judged(again) == judged(live)
    assert live["counters"].get("clock_steps", 0) == (step_s != 0.0)


def test_a_pause_in_which_values_go_stale_ends_with_a_time_mark_in_the_recording(
    tmp_path: Path,
) -> None:
    # GIVEN a bus that pauses for less than it takes to make time marks
    record = tmp_path / "pause.log"
    live = paused(0.4, 0.0, record)
    frames = list(read_frames(record))
    _, mark = [place for place, frame in enumerate(frames) if is_own(frame)]
    assert frames[mark].t_ns == frames[mark + 1].t_ns
    again, _ = replay.replay(record, SETUP)
    assert judged(again) == judged(live)


@pytest.mark.parametrize(("asleep_s", "stamps_go_on"), [(8 * 3600.0, True), (61.0, False)])
def test_a_machine_that_was_suspended_has_heard_nothing_and_misses_nothing(
    asleep_s: float, stamps_go_on: bool, tmp_path: Path
) -> None:
    # GIVEN a machine that sleeps in the middle of a drive, and an interface whose clock is the
    # machine's or its own, which sleeps as well
    stamped_s = asleep_s if stamps_go_on else 0.0
    rest = DRIVE._replace(t_ns=DRIVE.t_ns + round((stamped_s + TRUE_S[-1] + 0.01) * S))
    later_s = TRUE_S + TRUE_S[-1] + 0.01
    bus = Arriving(joined([DRIVE, rest]), [*TRUE_S.tolist(), *later_s.tolist()])
    record = tmp_path / "slept.log"

    def slept_s() -> float:
        return asleep_s if bus.now_s >= later_s[0] else 0.0

    with bus:
        loop = bus.loop = Listening(
            bus, SETUP, record=record, monotonic_s=lambda: bus.now_s + slept_s(), slept_s=slept_s
        )
        loop.run()
    live = loop.result("slept")
    # THEN the window begun is discarded, nothing is missed, and the replay agrees
    assert live["dtcs"] == []
    assert live["counters"]["log_gaps"] == 1
    assert loop.cycles == 0  # of an engine that was not heard nothing is known
    ends_s = [window["t_end_s"] - window["t_start_s"] for window in live["windows"]]
    assert 0.0 < max(ends_s) < 20.0
    again, _ = replay.replay(record, SETUP)
    assert judged(again) == judged(live)


@settings(max_examples=8, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    rate=st.sampled_from([1e-3, 1e-2, 0.1]),
    kind=st.sampled_from(["steps", "stamps", "both"]),
)
def test_no_clock_and_no_stamps_set_a_code_on_a_live_bus_and_the_replay_agrees(
    seed: int, rate: float, kind: str
) -> None:
    drive = healthy(15.0)
    rng = np.random.default_rng(seed)
    frames = jumping(drive, rng, rate, kind)
    found = lived(frames, arrivals(drive.t_ns, rng), SETUP)  # raises where the replay differs
    assert (found.codes, found.cycles) == ((), 0)


class Bench:
    def __init__(self) -> None:
        self.now_s = 100.0
        self.clock = Clock(lambda: self.now_s, PAUSE_NS)

    def hear(self, t_s: float, passed_s: float = 0.01) -> Iterator[float]:
        """Yield the believed times, in s, of a frame that arrives after some time."""
        self.now_s += passed_s
        t_ns = min(round(t_s * S), LATEST_NS)  # as the bus gives it
        block = block_of([Frame(t_ns, 1, False, b"")])
        for each in frames_of(self.clock.believed(block, self.now_s)):
            if not is_own(each):
                yield each.t_ns / S


@settings(max_examples=50, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    kind=st.sampled_from(["steps", "stamps", "both"]),
    size=st.integers(1, 200),
)
def test_frames_that_arrive_together_are_believed_as_one_by_one(
    seed: int, kind: str, size: int
) -> None:
    # GIVEN frames whose times jump now and then, some of which arrive at one moment
    frames = jumping(healthy(4.0), np.random.default_rng(seed), 1e-2, kind)
    one, many = Bench(), Bench()
    for begin in range(0, len(frames.t_ns), size):
        block = chosen(frames, slice(begin, begin + size))
        now_s = 100.0 + (begin + size) / 200
        one.now_s = many.now_s = now_s
        weighed = [each for f in frames_of(block) for each in one.clock.weighed(f, now_s)]
        believed = list(frames_of(many.clock.believed(block, now_s)))
        assert believed == weighed
    assert many.clock.counters == one.clock.counters


def test_frames_that_gathered_while_the_process_stood_still_are_believed() -> None:
    bench = Bench()
    times_s = [1000.0 + k / 100 for k in range(100)]
    arrived = [0.01] * 50 + [5.0] + [0.0] * 49
    believed = [
        t for t, passed_s in zip(times_s, arrived, strict=True) for t in bench.hear(t, passed_s)
    ]
    assert believed == times_s
    # and what was lost when the socket's buffer was full is a pause
    assert list(bench.hear(1005.0, 0.0)) == [1005.0]
    assert bench.clock.counters.found == {}


def test_frames_of_before_and_behind_a_long_wait_may_arrive_at_once() -> None:
    bench = Bench()
    list(bench.hear(1000.0))
    assert list(bench.hear(1000.01, 600.0)) == [1000.01]
    assert list(bench.hear(1600.01, 0.0)) == [1600.01]
    assert bench.clock.counters.found == {}


def test_a_clock_that_drifts_is_believed_for_ever() -> None:
    bench = Bench()
    for k in range(1, 10_000):
        assert next(bench.hear(1000.0 + 0.1 * k * 1.0004, 0.1)) > 0.0
    for k in range(1, 10_000):
        assert next(bench.hear(2_000.4 + 0.1 * k * 0.9996, 0.1)) > 0.0
    assert bench.clock.counters.found == {}


@pytest.mark.parametrize("first_s", [0.0, -1.0, 1e12, 5.0])
def test_a_first_frame_of_any_time_does_not_break_with_the_marks_before_it(first_s: float) -> None:
    bench = Bench()
    bench.now_s += 11.0
    mark = bench.clock.mark()
    assert mark is not None
    (believed_s,) = bench.hear(first_s)
    assert 0.0 <= believed_s - mark.t_ns / S < 0.2
    (second_s,) = bench.hear(first_s + 0.01)
    assert 0.0 <= second_s - believed_s < 0.2


def test_so_many_doubtful_frames_as_agree_are_a_clock_step_and_fewer_are_outliers() -> None:
    bench = Bench()
    for k in range(20):
        list(bench.hear(1000.0 + k / 100))
    for k in range(AGREEING - 1):
        list(bench.hear(2000.0 + k / 100))
    list(bench.hear(1000.0 + (20 + AGREEING) / 100))
    assert bench.clock.counters.found == {"outliers": AGREEING - 1}
    for k in range(AGREEING):
        list(bench.hear(2000.0 + k / 100))
    assert bench.clock.counters.found == {"outliers": AGREEING - 1, "clock_steps": 1}
    assert next(bench.hear(2000.0 + AGREEING / 100)) < 1001.0
