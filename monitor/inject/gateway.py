"""Fault injection between two buses, and writing of a changed log."""

import select
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import can

from monitor.base.counts import counted
from monitor.base.errors import RecordingError
from monitor.base.files.outputs import replaced
from monitor.base.types import Frame
from monitor.bus.link.clock import BEHIND_S, SILENCE_S
from monitor.bus.link.recorder import Recorder, message_of
from monitor.frames.channels import Channels
from monitor.frames.logs import frame_of, log_kind
from monitor.frames.loop_frames import bus_state, is_own, time_mark
from monitor.inject.injector import Injector
from monitor.inject.side import Side

POLL_S: Final = 0.001  # polling interval of interfaces without a file descriptor
IDLE_S: Final = 0.1  # longest wait, so that a signal is noticed
BURST: Final = 200  # most frames from one side before the other side is read


def write_log(path: Path, frames: Iterable[Frame], channel: str = "") -> None:
    """Write frames to a log in the format of its suffix, as ``Recorder``.

    Raises RecordingError if the format is unknown, the file cannot be written or no frame comes.
    """
    log_kind(path)  # checks the final name, not that of the temporary file
    n = 0
    with replaced(path) as begun, Recorder(begun, channel) as recorder:
        for block in Channels().blocks_of((frame, "") for frame in frames):
            recorder.write(block)
            n += len(block.key)
        if not n:
            raise RecordingError(f"{path}: no frame is left to write")


@dataclass(slots=True)
class Passed:
    """Counts of the frames that passed a gateway."""

    to_ecu: int = 0
    failed: int = 0  # frames that could not be sent
    error_frames: int = 0  # received on either side; they are never passed on
    flags: dict[tuple[int, bool], can.Message] = field(default_factory=dict)


class Gateway:
    """Passes frames between the ECU's bus and another, and injects faults into the ECU's frames.

    A lost interface is opened again; meanwhile the frames of the other one are discarded.

    taken : receives every sent frame of the ECU, a time mark on a silent bus, and a frame that
        reports whether an interface is lost
    """

    def __init__(
        self,
        ecu: Side,
        other: Side,
        injector: Injector,
        taken: Callable[[Frame], object] = lambda _: None,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._ecu, self._other, self._injector, self._taken = ecu, other, injector, taken
        self._now_s = monotonic_s
        self._stop = self._is_off = False
        self._heard: tuple[int, float] | None = None  # last ECU frame: bus time, monotonic s
        self._last_ns = 0  # bus time of the last sent frame or time mark
        self.passed = Passed()

    def stop(self, *_: object) -> None:
        """End the run after the current frame; a signal handler may call it."""
        self._stop = True

    def run(self, duration_s: float | None = None) -> None:
        """Pass frames until stopped, or for ``duration_s``.

        Raises BusError if an interface fails and cannot be opened again.
        """
        until_s = float("inf") if duration_s is None else self._now_s() + duration_s
        try:
            while not self._stop and self._now_s() < until_s:
                if not self.step():
                    self._wait(until_s - self._now_s())
            for frame in self._injector.flush():
                self._give(frame)
        finally:
            self.close()

    def step(self) -> bool:
        """Pass the received and due frames; return whether more may be waiting."""
        busy = [self._from(self._ecu, self._pass), self._from(self._other, self._pass_back)]
        self._due()
        return any(busy)

    def close(self) -> None:
        """Shut down buses that were opened again; the caller owns the first ones."""
        self._ecu.close()
        self._other.close()

    def _from(self, side: Side, take: Callable[[can.Message], None]) -> bool:
        """Take what a side has received; return whether more may be waiting."""
        for _ in range(BURST):
            message = side.receive()
            if message is None:
                return False
            if message.is_error_frame:
                self.passed.error_frames += 1
            else:
                take(message)
        return True

    def _pass(self, message: can.Message) -> None:
        if message.is_remote_frame:
            self._send(self._other, message)
            return
        frame = frame_of(message)
        if not message.timestamp:  # the interface gives no time
            frame = frame._replace(t_ns=time.time_ns() // 1000 * 1000)
        if self._heard is None:
            self._last_ns = frame.t_ns
        self._heard = (frame.t_ns, self._now_s())
        self.passed.flags[message.arbitration_id, message.is_extended_id] = message
        for out in self._injector.push(frame):
            self._give(out)

    def _pass_back(self, message: can.Message) -> None:
        self.passed.to_ecu += self._send(self._ecu, message)

    def _due(self) -> None:
        """Send the frames that are due while the ECU is silent.

        Report lost interfaces and the passing of time to ``taken``.
        """
        if self._heard is None:
            return
        t_ns, at_s = self._heard
        now_ns = t_ns + round((self._now_s() - at_s) * 1e9)
        if self._injector.due_ns <= now_ns:
            for frame in self._injector.advance(now_ns):
                self._give(frame)
        behind_ns = now_ns - round(BEHIND_S * 1e9)
        is_off = self._ecu.is_lost or self._other.is_lost
        if is_off != self._is_off:
            self._is_off = is_off
            self._taken(bus_state(max(behind_ns, self._last_ns), off=is_off))
        if now_ns - self._last_ns > SILENCE_S * 1e9:
            self._last_ns = now_ns
            self._taken(time_mark(behind_ns))

    def _give(self, frame: Frame) -> None:
        message = message_of(frame)
        like = self.passed.flags.get((frame.can_id, frame.is_extended))
        if like is not None:
            message.is_fd, message.bitrate_switch = like.is_fd, like.bitrate_switch
        if self._send(self._other, message):
            self._last_ns = frame.t_ns
            if not is_own(frame):  # a monitor refuses the loop's identifiers from a bus
                self._taken(frame)

    def _send(self, side: Side, message: can.Message) -> bool:
        taken = side.send(message)
        self.passed.failed += not taken
        return taken

    def _wait(self, left_s: float) -> None:
        """Wait until a frame arrives or is due, at most ``left_s``."""
        limit_s = min(IDLE_S, max(left_s, 0.0))
        if self._heard is not None:
            t_ns, at_s = self._heard
            due_s = (self._injector.due_ns - t_ns) / 1e9 - (self._now_s() - at_s)
            limit_s = min(limit_s, max(due_s, 0.0))
        sides = (self._ecu, self._other)
        limit_s = min([limit_s, *(side.wait_s for side in sides if side.bus is None)])
        filenos = [side.fileno for side in sides if side.bus is not None]
        if min(filenos, default=0) >= 0:
            select.select(filenos, [], [], limit_s)
        else:
            time.sleep(min(POLL_S, limit_s))

    def lines(self) -> Iterator[str]:
        """Yield the closing lines."""
        yield from self._injector.counts.lines()
        done = self.passed
        yield (
            f"{done.to_ecu} frames to the ECU; {done.failed} not sent, "
            f"{done.error_frames} error frames"
        )
        for side in (self._ecu, self._other):
            if side.datagrams.malformed:
                yield f"{side.name}: {side.datagrams.malformed} malformed datagrams"
            if losses := side.losses:
                back = counted(side.reconnects, "time")
                yield f"{side.name}: lost {counted(losses, 'time')}, back {back}"
