"""The queue and the thread between the live loop and a sink."""

import json
import resource
import threading
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import pytest

from monitor.base.foreign import ForeignError
from monitor.sinks import outlet as outlet_module
from monitor.sinks.address import open_sink
from monitor.sinks.outlet import BATCH, Outlet
from monitor.sinks.record import Record
from monitor.sinks.written import Written
from tests.helpers.bus.beside import until


class Fake:
    """A sink that keeps what it takes; it fails while ``error`` is set, and waits for ``gate``."""

    def __init__(self, error: Exception | None = None) -> None:
        self.error, self.gate = error, threading.Event()
        self.gate.set()
        self.taken: list[Record] = []
        self.closed = 0

    def write(self, records: Sequence[Record]) -> None:
        self.gate.wait(5.0)
        if self.error:
            raise self.error
        self.taken += records

    def close(self) -> None:
        self.closed += 1


outlet_of = partial(Outlet, "fake")


def record(k: int) -> Record:
    return Record("cycle", k, {"started": True})


@pytest.fixture(autouse=True)
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"QUEUED": 100, "AGAIN_S": 0.01, "FLUSH_S": 0.005}.items():
        monkeypatch.setattr(outlet_module, name, value)


def test_records_arrive_in_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outlet_module, "QUEUED", 3 * BATCH)
    sink = Fake()
    outlet = outlet_of(sink)
    for k in range(2 * BATCH + 7):
        outlet.put(record(k))
    outlet.close()
    assert [each.t_ns for each in sink.taken] == list(range(2 * BATCH + 7))
    counters = {"sent": 2 * BATCH + 7, "dropped": 0, "lost": 0}
    assert outlet.entry() == {"sink": "fake", "state": "connected", **counters}
    assert sink.closed == 1


def test_a_sink_that_hangs_does_not_hold_the_loop_and_its_oldest_records_are_dropped() -> None:
    # GIVEN a sink that hangs in its first write
    sink = Fake()
    sink.gate.clear()
    outlet = outlet_of(sink)
    outlet.put(record(0))
    assert until(lambda: not outlet._queue)
    # WHEN ten times as many records come as the queue holds
    begin_s = time.perf_counter()
    for k in range(1, 1001):
        outlet.put(record(k))
    # THEN no put has waited, and when the sink goes on all are sent or counted
    assert time.perf_counter() - begin_s < 1.0
    sink.gate.set()
    outlet.close()
    assert [each.t_ns for each in sink.taken] == [0, *range(901, 1001)]
    assert (outlet.sent, outlet.dropped) == (101, 900)


def test_a_lost_connection_is_tried_again_and_nothing_is_lost_meanwhile() -> None:
    sink = Fake(OSError("Connection refused"))
    outlet = outlet_of(sink)
    outlet.put(record(1))
    assert until(lambda: sink.closed >= 3)
    outlet.put(record(2))
    assert outlet.state == "lost"
    sink.error = None
    assert until(lambda: outlet.sent == 2)
    outlet.close()
    assert outlet.notes() == [
        "sink fake takes nothing: Connection refused; it is tried again",
        "sink fake takes records again",
    ]
    assert outlet.entry()["lost"] == 1
    assert [each.t_ns for each in sink.taken] == [1, 2]


def test_a_sink_that_never_returns_keeps_no_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("monitor.sinks.outlet.END_S", 0.05)
    sink = Fake()
    sink.gate.clear()
    outlet = outlet_of(sink)
    outlet.put(record(1))
    assert until(lambda: not outlet._queue)
    outlet.put(record(2))
    outlet.close()
    assert outlet.notes() == ["sink fake did not end within 0.05 s"]
    assert (outlet.sent, outlet.dropped) == (0, 2)
    sink.gate.set()


def test_a_replay_closes_every_sink_and_names_the_one_that_fails_at_its_end() -> None:
    class Gone(Fake):
        def close(self) -> None:
            raise ValueError("the socket is gone")

    sinks = [("first", Fake()), ("gone", Gone()), ("last", Fake())]
    with pytest.raises(ForeignError, match=r"^--sink gone fails: the socket is gone$"):
        Written(sinks, rate_hz=1.0).close()
    assert [sink.closed for _, sink in sinks] == [1, 0, 1]


def test_a_full_disk_leaves_no_torn_line_and_none_twice(tmp_path: Path) -> None:
    # GIVEN a file that may not grow beyond a line and a half
    file, limit = tmp_path / "car.jsonl", resource.getrlimit(resource.RLIMIT_FSIZE)
    sink = open_sink(f"jsonl:{file}", {})
    resource.setrlimit(resource.RLIMIT_FSIZE, (75, limit[1]))
    try:
        with pytest.raises(OSError, match="too large"):
            sink.write([record(1), record(2)])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    # WHEN there is room again THEN each record stands in it once
    sink.write([record(1), record(2)])
    sink.close()
    assert [json.loads(line)["t_ns"] for line in file.read_text().splitlines()] == [1, 2]
