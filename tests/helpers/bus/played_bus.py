"""A bus that is played from memory, and the live loop on it."""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import can

from monitor.base.types import Frame
from monitor.bus.attachment import Attachment
from monitor.bus.link.recorder import message_of
from monitor.bus.loop import Loop
from monitor.bus.transmit import Transmitter
from monitor.pipeline import replay


@dataclass
class Pause:
    """So many seconds of silence on the bus."""

    seconds: float


Script = Iterable[Frame | Pause | can.Message | Exception | None]


class PlayedBus(can.BusABC):
    """Gives messages as fast as they are asked for; its clock follows their times.

    script : an exception is raised, and None is one wait in which nothing comes
    """

    def __init__(self, script: Script) -> None:
        super().__init__(channel="played")
        self._script = iter(script)
        self.channel_info = "socketcan channel 'played'"
        self.now_s = 0.0
        self.sent: list[can.Message] = []
        self.stop = lambda: None
        self.is_shut = False

    def recv(self, timeout: float | None = None) -> can.Message | None:
        message, _ = self._recv_internal(timeout)
        if message is None or self._matches_filters(message):
            return message
        return self.recv(timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        item, self._pending = self._pending, None
        if item is None:
            try:
                item = next(self._script)
            except StopIteration:
                self.stop()
        if item is None:
            return None, False
        if isinstance(item, Exception):
            raise item
        if isinstance(item, Pause):
            self.now_s += timeout or 0.0
            left_s = item.seconds - (timeout or 0.0)
            self._pending = Pause(left_s) if left_s > 0 else None
            return None, False
        message = message_of(item) if isinstance(item, Frame) else item
        if self._first_s is None:
            self._first_s = message.timestamp - self.now_s
        self.now_s = max(self.now_s, message.timestamp - self._first_s)
        return message, False

    _pending: Any = None
    _first_s: float | None = None  # of the messages' clock when the bus's own showed 0

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.sent.append(msg)

    def shutdown(self) -> None:
        super().shutdown()
        self.is_shut = True


def played_on(
    script: Script, setup: replay.Setup, transmit: bool = False, **options: Any
) -> tuple[Loop, PlayedBus]:
    """Run the live loop to the end of a script."""
    bus = PlayedBus(script)
    with bus:
        quiet = {"say": lambda _: None, "monotonic_s": lambda: bus.now_s}
        loop = Loop(bus, setup, **(quiet | options))
        if transmit:
            loop.attachments.append(Transmitter(loop.pipeline.monitor))
        bus.stop = loop.stop
        loop.run()
    return loop, bus


def run_on(script: Script, setup: replay.Setup, **options: Any) -> tuple[dict[str, Any], PlayedBus]:
    loop, bus = played_on(script, setup, **options)
    return loop.result("played"), bus


def judged(recording: dict[str, Any]) -> str:
    """Return what must not differ between a run and the replay of its recording."""
    keys = ("samples", "enabled_samples", "windows", "dtcs", "fault_flag", "completed", "enable")
    return json.dumps({key: recording[key] for key in keys})


class Ear(Attachment):
    """An attachment that keeps what it is given, the frames of one identifier among it."""

    identifiers = ((0x6F0, False),)

    @property
    def due_s(self) -> float:
        self._maybe_fail("due")
        return float("inf")

    def __init__(self, fails_at: str = "") -> None:
        self.fails_at = fails_at
        self.heard: list[Frame] = []
        self.events: list[Any] = []
        self.worked = self.closed = 0

    def _maybe_fail(self, where: str) -> None:
        if where == self.fails_at:
            raise RuntimeError(f"no more {where}")

    def receive(self, frame: Frame) -> None:
        self._maybe_fail("receive")
        self.heard.append(frame)

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
