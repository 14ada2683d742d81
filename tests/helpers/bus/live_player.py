"""Plays frames through a pipeline into the live page's feed, as the loop would."""

import json
import time
from collections.abc import Iterable
from typing import Any

from monitor.base import config
from monitor.base.types import Frame
from monitor.bus.live.address import PageAddress
from monitor.bus.live.feed import LiveFeed
from monitor.bus.live.process import Server
from monitor.frames.blocks import block_of
from monitor.frames.logs import read_frames
from monitor.memory.dtc_store import DtcStore
from monitor.pipeline import replay
from monitor.pipeline.events import Tick, singly
from monitor.pipeline.frames import FramePipeline
from tests.conftest import ROOT


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

    def push(self, frames: Iterable[Frame]) -> None:
        """Judge frames; the feed writes a message for each quarter second of theirs."""
        for frame in frames:
            self.health["frames"] += 1
            for event in self.pipeline.push(block_of([frame])):
                for each in singly(event):
                    self.feed.push(each)
            self.feed.work(frame.t_ns / 1e9)

    def ticks(self, frame: Frame) -> list[Tick]:
        """Judge a frame without the feed; return its samples."""
        events = [each for event in self.pipeline.push(block_of([frame])) for each in singly(event)]
        return [event for event in events if isinstance(event, Tick)]

    def play(self, frames: Iterable[Frame], speed: float | None = None) -> None:
        """Play frames, at so many times real time, or as fast as possible."""
        start_s, first_ns = time.monotonic(), None
        for frame in frames:
            first_ns = frame.t_ns if first_ns is None else first_ns
            self.health["frames"] += 1
            for event in self.pipeline.push(block_of([frame])):
                for each in singly(event):
                    self.feed.push(each)
            due_s = start_s + (frame.t_ns - first_ns) / 1e9 / (speed or 1e9)
            while (wait_s := due_s - time.monotonic()) > 0.002:
                time.sleep(min(wait_s, 0.05))
                self.feed.work(time.monotonic())
            self.feed.work(time.monotonic())

    def work(self, seconds: float) -> None:
        """Let the time go by."""
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            self.feed.work(time.monotonic())
            time.sleep(0.02)

    def __enter__(self) -> "Player":
        return self

    def __exit__(self, *_: object) -> None:
        self.feed.close()


def frames_of(fault: str, seconds: float | None = None) -> list[Frame]:
    """Return the frames of one of the replay logs, the first so many seconds."""
    path = next(iter(sorted(ROOT.glob(f"replay_logs/{fault}_*.blf"))))
    frames = list(read_frames(path))
    if seconds is None:
        return frames
    return [frame for frame in frames if frame.t_ns < frames[0].t_ns + seconds * 1e9]
