"""Plays frames through a pipeline into the live page's feed, as the loop would."""

import json
import time
from collections.abc import Sequence
from typing import Any

from monitor.base import config
from monitor.base.types import Frame
from monitor.bus.live.address import PageAddress
from monitor.bus.live.feed import LiveFeed
from monitor.bus.live.process import Server
from monitor.frames.blocks import block_of
from monitor.memory.dtc_store import DtcStore
from monitor.pipeline import replay
from monitor.pipeline.events import Event, singly
from monitor.pipeline.frames import FramePipeline

GATHERED = 6  # frames of 25 ms


class Sink:
    """Takes the feed's lines in place of a server."""

    def __init__(self) -> None:
        self.address = PageAddress("127.0.0.1", 0)
        self.is_free, self.is_closed = True, False
        self.lines: list[bytes] = []

    def send(self, line: bytes) -> None:
        self.lines.append(line)

    def close(self) -> None:
        self.is_closed = True

    @property
    def messages(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.lines]


class Player:
    """A pipeline with a feed; closes both at the end of a with block."""

    def __init__(self, store: DtcStore | None = None, server: Any = None) -> None:
        self.setup = setup = replay.set_up(None, [], config.load())
        self.store = store or DtcStore()
        self.pipeline = FramePipeline(
            setup.bus_map, setup.model, setup.limits, setup.config, self.store
        )
        self.lines: list[str] = []
        self.health: dict[str, Any] = {"frames": 0, "error_frames": 0}
        self.server = server or Server(PageAddress("127.0.0.1", 0))
        self.url = self.server.address.url
        self.feed = LiveFeed(
            self.server,
            self.pipeline.monitor,
            setup,
            health=lambda: self.health,
            channel="vcan0",
            say=self.lines.append,
        )

    def judged(self, frames: Sequence[Frame]) -> list[Event]:
        found = self.pipeline.push(block_of(list(frames)))
        return [each for event in found for each in singly(event)]

    def push(self, frames: Sequence[Frame], speed: float | None = None) -> None:
        """Judge frames as they gather, and feed the page by their times, or so many times as fast.

        speed : times real time; without it as fast as possible
        """
        begin_s, first_ns = time.monotonic(), frames[0].t_ns
        for part in (frames[k : k + GATHERED] for k in range(0, len(frames), GATHERED)):
            self.health["frames"] += len(part)
            for event in self.judged(part):
                self.feed.push(event)
            if speed is None:
                self.feed.work(part[-1].t_ns / 1e9)
            else:
                due_s = begin_s + (part[-1].t_ns - first_ns) / 1e9 / speed
                self.work(due_s - time.monotonic())

    def work(self, seconds: float) -> None:
        until_s = time.monotonic() + seconds
        self.feed.work(time.monotonic())
        while (wait_s := until_s - time.monotonic()) > 0.002:
            time.sleep(min(wait_s, 0.02))
            self.feed.work(time.monotonic())

    def __enter__(self) -> "Player":
        return self

    def __exit__(self, *_: object) -> None:
        self.feed.close()
