"""Faults between two buses, or from log to log."""

import select
import signal
import socket
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import can

from monitor.bus.clock import BEHIND_S, SILENCE_S
from monitor.bus.port import receive
from monitor.bus.recorder import Recorder, message_of
from monitor.bus.socketcan import RECEIVE_BUFFER_BYTES
from monitor.inject.injector import Injector
from monitor.own_frames import time_mark
from monitor.sources import frame_of
from monitor.types import Frame

POLL_S: Final = 0.001  # between two looks at buses that cannot be waited for together
IDLE_S: Final = 0.1  # the longest wait, so that a signal is heard
SEND_TIMEOUT_S: Final = 0.05
BURST: Final = 200  # frames of one side before the other is looked at


def write_log(path: Path, frames: Iterable[Frame]) -> int:
    """Write frames to a log in the format of its suffix; return how many there were.

    Raises RecordingError if the format is unknown or the file cannot be written.
    """
    n = 0
    with Recorder(path) as recorder:
        for frame in frames:
            recorder.write(frame)
            n += 1
    return n


@dataclass(slots=True)
class Passed:
    """What went through a gateway."""

    to_ecu: int = 0
    failed: int = 0  # frames the interface did not take
    error_frames: int = 0  # seen on either side, never passed on
    flags: dict[tuple[int, bool], can.Message] = field(default_factory=dict)


class Gateway:
    """Passes frames between the ECU's bus and another, faults put into those of the ECU.

    taken : takes every frame of the ECU's side that goes out, and a time mark where none does
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
        self._last_ns = 0  # bus time of what was last given or marked
        self._filenos = _filenos(ecu, other)
        self._sockets = {id(bus) for bus in (ecu, other) if _set_up(bus)}
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
            message = receive(self._ecu, 0.0)
            if message is None:
                return False
            if message.is_error_frame:
                self.passed.error_frames += 1
            elif self._is_own(self._ecu, message):
                continue
            elif message.is_remote_frame:
                self._send(self._other, message)
            else:
                frame = frame_of(message)
                if not message.timestamp:  # the interface gives none
                    frame = frame._replace(t_ns=time.time_ns() // 1000 * 1000)
                if self._heard is None:
                    self._last_ns = frame.t_ns
                self._heard = (frame.t_ns, self._now_s())
                if message.is_fd:
                    self.passed.flags[message.arbitration_id, message.is_extended_id] = message
                for out in self._injector.push(frame):
                    self._give(out)
        return True

    def _to_ecu(self) -> bool:
        for _ in range(BURST):
            message = receive(self._other, 0.0)
            if message is None:
                return False
            if message.is_error_frame:
                self.passed.error_frames += 1
            elif not self._is_own(self._other, message):
                self.passed.to_ecu += self._send(self._ecu, message)
        return True

    def _is_own(self, bus: can.BusABC, message: can.Message) -> bool:
        """Return whether it is one that the gateway has sent, on a bus opened to hear these.

        SocketCAN gives none, and calls what other processes of this machine send not received.
        """
        return not message.is_rx and id(bus) not in self._sockets

    def _due(self) -> None:
        """Give what is due although the ECU says nothing just now; say that time passes."""
        if self._heard is None:
            return
        t_ns, at_s = self._heard
        now_ns = t_ns + round((self._now_s() - at_s) * 1e9)
        if self._injector.due_ns <= now_ns:
            for frame in self._injector.advance(now_ns):
                self._give(frame)
        if now_ns - self._last_ns > SILENCE_S * 1e9:
            self._last_ns = now_ns
            self._taken(time_mark(now_ns - round(BEHIND_S * 1e9)))

    def _give(self, frame: Frame) -> None:
        message = message_of(frame)
        like = self.passed.flags.get((frame.can_id, frame.is_extended))
        if like is not None:
            message.is_fd, message.bitrate_switch = True, like.bitrate_switch
        if self._send(self._other, message):
            self._last_ns = frame.t_ns
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


def _set_up(bus: can.BusABC) -> bool:
    """Give SocketCAN's socket room for a burst and keep its own frames off it.

    Returns whether it is one; other interfaces stay as they are.
    """
    own = getattr(bus, "socket", None)
    if not isinstance(own, socket.socket):
        return False
    own.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
    if own.family == getattr(socket, "AF_CAN", None):
        own.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_RECV_OWN_MSGS, 0)
        return True
    return False


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
