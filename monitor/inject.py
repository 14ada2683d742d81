"""Faults between two buses, or from log to log."""

import select
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import can

from monitor.errors import BusError, RecordingError
from monitor.injector import Injector
from monitor.sources import frame_of, log_kind
from monitor.types import Frame

POLL_S: Final = 0.001  # between two looks at buses that cannot be waited for together
IDLE_S: Final = 0.1  # the longest wait, so that a signal is heard
SEND_TIMEOUT_S: Final = 0.05
BURST: Final = 200  # frames of one side before the other is looked at


def write_log(path: Path, frames: Iterable[Frame]) -> int:
    """Write frames to a log in the format of its suffix; return how many there were.

    Raises RecordingError if the format is unknown or the file cannot be written.
    """
    log_kind(path)
    n = 0
    try:
        with can.Logger(path) as logger:
            for frame in frames:
                logger.on_message_received(message_of(frame))
                n += 1
    except RecordingError:
        raise
    except (OSError, ValueError, NotImplementedError, ImportError) as error:
        raise RecordingError(f"{path}: cannot write the log: {error}") from None
    return n


def message_of(frame: Frame, like: can.Message | None = None) -> can.Message:
    """Return a frame as python-can's message.

    like : a message whose CAN FD flags it takes; without one a long frame is CAN FD
    """
    return can.Message(
        timestamp=frame.t_ns / 1e9,
        arbitration_id=frame.can_id,
        is_extended_id=frame.is_extended,
        data=frame.data,
        is_fd=like.is_fd if like else len(frame.data) > 8,
        bitrate_switch=like.bitrate_switch if like else False,
    )


@dataclass(slots=True)
class Passed:
    """What went through a gateway."""

    to_ecu: int = 0
    failed: int = 0  # frames the interface did not take
    error_frames: int = 0  # seen on either side, never passed on
    flags: dict[tuple[int, bool], can.Message] = field(default_factory=dict)


class Gateway:
    """Passes frames between the ECU's bus and another, faults put into those of the ECU.

    taken : takes every frame of the ECU's side that goes out
    """

    def __init__(
        self,
        ecu: can.BusABC,
        other: can.BusABC,
        injector: Injector,
        taken: Callable[[Frame], None] = lambda _: None,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._ecu, self._other, self._injector, self._taken = ecu, other, injector, taken
        self._now_s = monotonic_s
        self._stop = False
        self._heard: tuple[int, float] | None = None  # bus time and clock of the last ECU frame
        self._filenos = _filenos(ecu, other)
        self.passed = Passed()

    def stop(self, *_: object) -> None:
        """End after the frame in hand; may be called from a signal handler."""
        self._stop = True

    def run(self, duration_s: float | None = None) -> None:
        """Pass frames until stopped, or for so long.

        Raises BusError when an interface fails.
        """
        until_s = float("inf") if duration_s is None else self._now_s() + duration_s
        while not self._stop and self._now_s() < until_s:
            busy = self._from_ecu()
            busy = self._to_ecu() or busy
            self._due()
            if not busy:
                self._wait(until_s - self._now_s())
        for frame in self._injector.flush():
            self._give(frame)

    def _from_ecu(self) -> bool:
        message: can.Message | None = None
        for _ in range(BURST):
            message = _receive(self._ecu)
            if message is None:
                return False
            if message.is_error_frame:
                self.passed.error_frames += 1
            elif message.is_remote_frame:
                self._send(self._other, message)
            else:
                frame = frame_of(message)
                if not message.timestamp:  # the interface gives none
                    frame = frame._replace(t_ns=time.time_ns() // 1000 * 1000)
                self._heard = (frame.t_ns, self._now_s())
                if message.is_fd:
                    self.passed.flags[message.arbitration_id, message.is_extended_id] = message
                for out in self._injector.push(frame):
                    self._give(out)
        return True

    def _to_ecu(self) -> bool:
        for _ in range(BURST):
            message = _receive(self._other)
            if message is None:
                return False
            if message.is_error_frame:
                self.passed.error_frames += 1
            else:
                self.passed.to_ecu += self._send(self._ecu, message)
        return True

    def _due(self) -> None:
        """Give what is due although the ECU says nothing just now."""
        if self._heard is not None and self._injector.due_ns < float("inf"):
            t_ns, at_s = self._heard
            for frame in self._injector.advance(t_ns + round((self._now_s() - at_s) * 1e9)):
                self._give(frame)

    def _give(self, frame: Frame) -> None:
        like = self.passed.flags.get((frame.can_id, frame.is_extended))
        if self._send(self._other, message_of(frame, like)):
            self._taken(frame)

    def _send(self, bus: can.BusABC, message: can.Message) -> bool:
        try:
            bus.send(message, timeout=SEND_TIMEOUT_S)
        except (can.CanError, OSError, ValueError):
            self.passed.failed += 1
            return False
        return True

    def _wait(self, left_s: float) -> None:
        """Wait until a frame is there or something is due."""
        limit_s = min(IDLE_S, max(left_s, 0.0))
        if self._heard is not None:
            t_ns, at_s = self._heard
            due_s = (self._injector.due_ns - t_ns) / 1e9 - (self._now_s() - at_s)
            limit_s = min(limit_s, max(due_s, 0.0))
        if self._filenos:
            select.select(self._filenos, [], [], limit_s)
        else:
            time.sleep(min(POLL_S, limit_s))

    def lines(self) -> Iterator[str]:
        """Yield what to print at the end."""
        yield from self._injector.counts.lines()
        done = self.passed
        yield (
            f"{done.to_ecu} frames to the ECU; {done.failed} not sent, "
            f"{done.error_frames} error frames"
        )


def _filenos(*buses: can.BusABC) -> list[int]:
    """Return what to wait for, nothing if a bus has none."""
    try:
        found = [bus.fileno() for bus in buses]
    except NotImplementedError:
        return []
    return found if all(each >= 0 for each in found) else []


def _receive(bus: can.BusABC) -> can.Message | None:
    try:
        return bus.recv(0)
    except (can.CanError, OSError) as error:
        raise BusError(f"{bus.channel_info}: {error}") from None


@contextmanager
def ended_by_signals(stop: Callable[..., None]) -> Iterator[None]:
    """Call ``stop`` on SIGINT and SIGTERM."""
    signals = (signal.SIGINT, signal.SIGTERM)
    previous = {number: signal.signal(number, stop) for number in signals}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
