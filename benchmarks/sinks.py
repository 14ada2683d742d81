"""What sinks cost the live loop: a played drive without sinks, and with three that behave badly.

    python benchmarks/sinks.py [--rounds 3]

One sink hangs in its first write, one refuses every connection, one takes everything. It prints the
time of the loop's thread per frame, and the time of one event on its way to the three queues.
"""

import argparse
import os
import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from repository import ROOT

from monitor.base import config
from monitor.bus.loop import Loop
from monitor.bus.sink_feed import SinkFeed
from monitor.frames.logs import read_frames
from monitor.report import replay
from monitor.sinks.outlet import Outlet
from monitor.sinks.record import Record
from monitor.sinks.stream import Stream
from tests.helpers.played_bus import PlayedBus

LOG = next((ROOT / "replay_logs").glob("delay_rich_to_lean_*.blf"))


class Hanging:
    def write(self, records: Sequence[Record]) -> None:
        time.sleep(1e6)

    def close(self) -> None:
        pass


class Refusing(Hanging):
    def write(self, records: Sequence[Record]) -> None:
        raise OSError("Connection refused")


class Taking(Hanging):
    def write(self, records: Sequence[Record]) -> None:
        pass


class TimedFeed(SinkFeed):
    """A feed that keeps the duration of every event, and leaves the outlets open."""

    def __init__(self, *about: Any) -> None:
        super().__init__(*about)
        self.durations_s: list[float] = []

    def push(self, event: Any) -> None:
        begin_s = time.perf_counter()
        super().push(event)
        self.durations_s.append(time.perf_counter() - begin_s)

    def close(self) -> None:
        pass  # the hanging sink would be waited for


def played(setup: replay.Setup, frames: list[Any], sinks: Sequence[Any]) -> tuple[float, Any]:
    """Return the time of the loop's thread, and the durations of the events in s."""
    bus, feed = PlayedBus(frames), None
    with bus:
        loop = Loop(bus, setup, say=lambda _: None, monotonic_s=lambda: bus.now_s)
        bus.stop = loop.stop
        if sinks:
            outlets = [Outlet(type(sink).__name__, sink) for sink in sinks]
            stream = Stream(loop.pipeline.monitor, 1.0)
            feed = TimedFeed(stream, outlets, loop.health, lambda _: None)
            loop.attachments.append(feed)
        begin_s = time.thread_time()
        loop.run()
        return time.thread_time() - begin_s, feed and np.array(feed.durations_s)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    rounds = parser.parse_args().rounds
    setup, frames = replay.set_up(None, [], config.load()), list(read_frames(LOG))
    without, with_sinks, events = [], [], []
    for _ in range(rounds):
        without.append(played(setup, frames, ())[0])
        seconds, durations_s = played(setup, frames, (Hanging(), Refusing(), Taking()))
        with_sinks.append(seconds)
        events.append(durations_s)
    a, b = (min(each) / len(frames) * 1e6 for each in (without, with_sinks))
    median, high = np.percentile(np.concatenate(events), [50, 99]) * 1e6
    print(f"{len(frames)} frames: {a:.2f} us per frame without sinks, {b:.2f} us with three")
    print(f"an event: {median:.1f} us in the median, {high:.0f} us at the 99th percentile")
    sys.stdout.flush()
    os._exit(0)  # the hanging sink never ends


if __name__ == "__main__":
    main()
