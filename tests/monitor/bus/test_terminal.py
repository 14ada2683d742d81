"""What a run prints: to a person, a program, a journal; and what it tells the service manager."""

import io
import json
import os
import pty
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from monitor.base.types import Frame
from monitor.bus.ending import ended_by_signals
from monitor.bus.loop import Loop
from monitor.bus.terminal import REDRAW_S, WAITING_LINES, EventLines, Out, Screen, StatusLine
from monitor.bus.watchdog import Watchdog
from monitor.judge.enable import TABLE
from monitor.memory.store import Memory
from monitor.pipeline import replay
from monitor.pipeline.events import Event, Tick
from tests.helpers.bus.played_bus import Ear, played_on


@pytest.fixture(scope="module")
def loop(setup: replay.Setup, late_sensor: list[Frame]) -> Loop:
    """A loop at the end of a faulty drive, with what it said in its Ear."""
    return played_on(late_sensor, setup, attachments=[Ear()])[0]


def events(loop: Loop) -> list[Event]:
    return next(a.events for a in loop.attachments if isinstance(a, Ear))


def test_a_journal_gets_a_line_for_every_event_but_ticks(loop: Loop) -> None:
    stream = io.StringIO()
    view = EventLines(loop.pipeline.monitor, loop.health, loop.collector, Out(stream))
    for event in events(loop):
        view.push(event)
        view.work(0.0)
    view.close()
    lines = stream.getvalue().splitlines()
    assert len(lines) == sum(not isinstance(e, Tick) for e in events(loop))
    assert any("window 0" in line for line in lines)
    assert any("P015A delay_rich_to_lean pending" in line for line in lines)
    assert "\x1b" not in stream.getvalue()


def test_the_status_says_what_is_measured_what_blocks_and_how_the_bus_is(loop: Loop) -> None:
    status = StatusLine(loop.pipeline.monitor, loop.health)
    assert "nothing received yet" in status.line()
    for event in events(loop):
        status.push(event)
        if isinstance(event, Tick) and event.enabled:
            assert "enabled" in status.line()
        elif isinstance(event, Tick):
            blocking = TABLE[event.conditions.index(False)].words
            assert f"waits until {blocking}" in status.line()
    line = status.line()
    assert "P015A pending" in line
    assert "bus active" in line
    assert f"{loop.health.frames} frames" in line
    assert "lost" not in line
    bad = replace(loop.health, drops=3, overruns=4, reconnects=5)
    assert "lost 7 reconnects 5" in StatusLine(loop.pipeline.monitor, bad).line()


def test_the_screen_is_drawn_four_times_a_second_at_most(loop: Loop) -> None:
    stream = io.StringIO()
    screen = Screen(loop.pipeline.monitor, loop.health, loop.collector, Out(stream))
    ticks = [e for e in events(loop) if isinstance(e, Tick)][:1000]
    for number, tick in enumerate(ticks):
        screen.push(tick)
        screen.work(number * 0.01)  # ten seconds
        assert screen.due_s <= number * 0.01 + REDRAW_S
    drawn = stream.getvalue().count("\r\x1b[K")
    assert 20 <= drawn <= 41
    assert "\n" not in stream.getvalue()
    # AND what is left is a clean line
    screen.close()
    assert stream.getvalue().endswith("\r\x1b[K")


def test_a_terminal_that_hangs_holds_up_nothing_and_gets_the_latest_when_it_goes_on() -> None:
    # GIVEN a terminal whose other side reads nothing
    master, slave = pty.openpty()
    with os.fdopen(slave, "w") as stream:
        out = Out(stream)
        # WHEN far more is said than it can hold, also when the loop ends
        for number in range(5 * WAITING_LINES):
            out.say(f"line {number}")
            if number == 4 * WAITING_LINES:
                out.close()
        # THEN the latest lines come once it reads again
        text = b""
        for _ in range(100_000):
            if not select.select([master], [], [], 0.0)[0]:
                out.flush()
                if not select.select([master], [], [], 0.1)[0]:
                    break
            text += os.read(master, 65536)
    os.close(master)
    assert text.split()[-1] == str(5 * WAITING_LINES - 1).encode()
    assert text.count(b"\n") < 5 * WAITING_LINES


def test_a_pipe_whose_reader_has_gone_ends_nothing() -> None:
    there, here = os.pipe()
    os.close(there)
    with os.fdopen(here, "w") as stream:
        out = Out(stream)
        for _ in range(100):
            out.say("x" * 1000)
        assert not out.waiting  # nothing waits for a reader that will not come


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as own:
        own.bind(str(tmp_path / "notify"))
        own.settimeout(1.0)
        yield own


def watchdog(manager: socket.socket, **environment: str) -> Watchdog:
    found = Watchdog.of(lambda: "well", {"NOTIFY_SOCKET": manager.getsockname(), **environment})
    assert found is not None
    return found


def heard(manager: socket.socket) -> list[str]:
    return manager.recv(4096).decode().splitlines()


def test_the_service_manager_hears_ready_alive_and_stopping(manager: socket.socket) -> None:
    own = watchdog(manager, WATCHDOG_USEC="2000000", WATCHDOG_PID=str(os.getpid()))
    assert own.due_s == -float("inf")
    own.work(10.0)
    assert heard(manager) == ["READY=1", "WATCHDOG=1", "STATUS=well"]
    assert own.due_s == 11.0  # twice as often as the manager asks
    own.work(11.0)
    assert heard(manager) == ["WATCHDOG=1"]
    own.close()
    assert heard(manager) == ["STOPPING=1"]


@pytest.mark.parametrize(
    "environment", [{}, {"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "1"}, {"WATCHDOG_USEC": "0"}]
)
def test_a_manager_that_does_not_watch_hears_no_watchdog(
    manager: socket.socket, environment: dict[str, str]
) -> None:
    own = watchdog(manager, **environment)
    own.work(0.0)
    assert heard(manager) == ["READY=1", "STATUS=well"]
    assert own.due_s == 10.0
    own.close()


def test_a_manager_that_is_gone_ends_nothing(manager: socket.socket, tmp_path: Path) -> None:
    own = watchdog(manager, WATCHDOG_USEC="1000000")
    (tmp_path / "notify").unlink()
    assert own.work(0.0) == ()
    assert own.due_s == 0.5  # it may come back
    own.close()


@pytest.mark.parametrize(
    "signals", [[signal.SIGTERM], 2 * [signal.SIGHUP]], ids=["a service", "a terminal hangs up"]
)
def test_a_run_that_is_ended_from_outside_says_and_stores_what_it_found(
    signals: list[signal.Signals], manager: socket.socket, tmp_path: Path
) -> None:
    # GIVEN the monitor as a service manager starts it, on a bus nobody sends to
    memory, out, page = (tmp_path / name for name in ("o2.db", "out.json", "out.html"))
    command = ["run", "-i", "virtual", "-c", "silent", "--quiet", "--sink", "jsonl:-"]
    command += ["--memory", str(memory), "--json", str(out), "--html", str(page)]
    environment = os.environ | {"NOTIFY_SOCKET": manager.getsockname(), "WATCHDOG_USEC": "200000"}
    with subprocess.Popen(
        [sys.executable, "-m", "monitor.cli", *command],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        manager.settimeout(120.0)
        assert "READY=1" in heard(manager)
        assert "WATCHDOG=1" in heard(manager)
        for each in signals:  # a hang-up comes from the kernel and from the shell
            process.send_signal(each)
        records, words = process.communicate(timeout=60.0)
    # THEN it ends by itself, says so, and has stored its memory
    assert process.returncode == 3  # nothing was judged
    told = []
    while not told or told[-1] != "STOPPING=1":
        told += heard(manager)
    assert [json.loads(line)["kind"] for line in records.splitlines()] == ["health", "health"]
    assert "not judged" in words and f"report: {page}" in words
    with closing(Memory(memory)) as stored:
        assert stored.load().counts is not None
    (recording,) = json.loads(out.read_text())["recordings"]
    assert recording["completed"] is False
    assert "</html>" in page.read_text()


def test_a_hang_up_that_is_ignored_stays_ignored() -> None:
    stopped: list[int] = []
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with ended_by_signals(lambda number, _: stopped.append(number)):
            os.kill(os.getpid(), signal.SIGHUP)
            os.kill(os.getpid(), signal.SIGTERM)
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
    assert stopped == [signal.SIGTERM]
