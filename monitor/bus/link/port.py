"""The bus of the live loop: receive, send, watch its health, open it again after a loss."""

import math
import time
from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass
from typing import Any, Final, Literal

import can

from monitor.base.types import Frame
from monitor.bus.link.connection import Connection
from monitor.bus.link.datagrams import Datagrams
from monitor.bus.link.error_frames import error_frame
from monitor.bus.link.recorder import message_of
from monitor.bus.link.socketcan import ErrorMessage, SocketReader
from monitor.frames.logs import frame_of

QUIET_S: Final = 10.0  # least time between two messages about the controller's state

State = Literal["active", "warning", "passive", "bus off", "gone"]
OFF: Final = ("bus off", "gone")


@dataclass(slots=True)
class BusHealth:
    """Counters and state of the bus and of the loop."""

    state: State = "active"  # of the controller; "gone" means that the interface is lost
    frames: int = 0  # received data frames, without the refused ones
    error_frames: int = 0
    remote_frames: int = 0
    refused: int = 0  # frames under identifiers reserved for the loop
    overruns: int = 0  # error frames that report frames lost in the controller
    drops: int | None = None  # frames lost because the socket's buffer was full, None if unknown
    malformed: int = 0  # datagrams that the interface could not read
    bus_off: int = 0  # times the controller went off the bus
    passive: int = 0  # times it became error passive
    warning: int = 0  # times its error counters reached the warning limit
    unacknowledged: int = 0  # error frames that report a missing acknowledgement
    losses: int = 0  # times the interface was lost
    reconnects: int = 0  # times the interface came back
    transmit_errors: int = 0
    stale: tuple[str, ...] = ()  # signals that are stale now
    stale_samples: int = 0  # samples with a stale signal
    memory_errors: int = 0  # failed attempts to store the fault memory
    detached: int = 0  # attachments removed after an exception
    sinks_off: tuple[str, ...] = ()  # sinks that take nothing now
    sinks_sent: int = 0  # records that the sinks took
    sinks_dropped: int = 0  # records that found no room in a queue, or that a sink refused
    sinks_lost: int = 0  # times a sink was lost
    receive_buffer_bytes: int = 0  # of the SocketCAN socket, 0 if unknown
    timestamps: Literal["kernel", "interface"] = "interface"

    def as_dict(self) -> dict[str, Any]:
        """Return the counters by name."""
        return asdict(self)


class Port:
    """One bus, used by one thread.

    health : updated by the port
    reopen : opens the bus again after a loss; without it a loss is an error
    say : receives messages about losses
    """

    def __init__(
        self,
        bus: can.BusABC,
        health: BusHealth,
        reopen: Callable[[], can.BusABC] | None = None,
        say: Callable[[str], None] = print,
        monotonic_s: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._health, self._say = health, say
        self._now_s, self._sleep = monotonic_s, sleep
        self._connection = Connection(bus, reopen, say, monotonic_s)
        self._filters: list[Any] | None = None
        self._quiet_until_s = -math.inf
        self._drops_before: int | None = 0  # frames dropped on earlier sockets, None if unknown
        self._datagrams = Datagrams()
        self._use(bus)

    def _use(self, bus: can.BusABC) -> None:
        self._bus: can.BusABC | None = bus
        self._reader = SocketReader.of(bus)
        self._is_socketcan = bus.channel_info.startswith("socketcan")
        if self._filters is not None:
            bus.set_filters(self._filters)
        if self._reader:
            self._health.receive_buffer_bytes = self._reader.buffer_bytes
            self._health.timestamps = "kernel"
        self._count_drops()

    @property
    def is_off(self) -> bool:
        """Return whether the monitor cannot hear the bus."""
        return self._health.state in OFF

    def set_filters(
        self, identifiers: Collection[tuple[int, bool]], groups: Collection[tuple[int, int]] = ()
    ) -> None:
        """Receive only these frames, given as identifier and whether it has 29 bits.

        groups : bits of 29-bit identifiers and their mask
        """
        self._filters = [
            {"can_id": can_id, "can_mask": 0x1FFFFFFF if long else 0x7FF, "extended": long}
            for can_id, long in sorted(identifiers)
        ]
        self._filters += [
            {"can_id": group, "can_mask": mask, "extended": True} for group, mask in sorted(groups)
        ]
        if self._bus:
            self._bus.set_filters(self._filters)

    def receive(self, timeout_s: float, tick_end_ns: int = 0) -> Frame | None:
        """Return the next frame, None if none arrives within ``timeout_s``.

        tick_end_ns : bus time before which no frame is urgent, so frames may gather until then
        Raises BusError if the interface fails and cannot be opened again.
        """
        if self._bus is None:
            self._try_again(timeout_s)
            return None
        try:
            if self._reader:
                frame = self._read(self._reader, timeout_s, tick_end_ns)
            else:
                frame = self._take(self._bus.recv(timeout_s))
        except Exception as error:  # python-can's interfaces raise any, on any datagram
            if not self._datagrams.survives(error):
                self._lose(error)
            self._health.malformed = self._datagrams.malformed
            return None
        self._datagrams.read()
        if self._health.state in OFF:
            self._recover(frame)
        return frame

    def _read(self, reader: SocketReader, timeout_s: float, tick_end_ns: int) -> Frame | None:
        received = reader.receive(timeout_s, tick_end_ns)
        if type(received) is Frame:
            self._health.frames += 1
            return received
        self._health.remote_frames = reader.remote_frames
        self._count_drops()
        if type(received) is ErrorMessage:
            self._heed(received.can_id, received.data)
        return None

    def _count_drops(self) -> int | None:
        """Return the frames dropped on all sockets so far, None if one of them does not tell."""
        own = self._reader.drops if self._reader else None
        before = self._drops_before
        drops = self._health.drops = None if own is None or before is None else before + own
        return drops

    def _take(self, message: can.Message | None) -> Frame | None:
        if message is None:
            return None
        if message.is_error_frame and self._is_socketcan:
            self._heed(message.arbitration_id, bytes(message.data))
        elif message.is_error_frame:  # other interfaces have other formats
            self._health.error_frames += 1
        elif message.is_remote_frame:
            self._health.remote_frames += 1
        else:
            self._health.frames += 1
            return frame_of(message)
        return None

    def _heed(self, can_id: int, data: bytes) -> None:
        """Update the health from a SocketCAN error frame."""
        health, meaning = self._health, error_frame(can_id, data)
        if health.state == "gone":
            self._recover(None)
        health.error_frames += 1
        health.overruns += meaning.overflow
        health.unacknowledged += meaning.no_acknowledge
        if meaning.state is None or meaning.state == health.state:
            return
        health.state = meaning.state
        health.bus_off += meaning.state == "bus off"
        health.passive += meaning.state == "passive"
        health.warning += meaning.state == "warning"
        if meaning.state in ("bus off", "passive") and self._now_s() >= self._quiet_until_s:
            self._quiet_until_s = self._now_s() + QUIET_S
            kind = f"{'error ' * (meaning.state == 'passive')}{meaning.state}"
            self._say(f"bus: the controller is {kind}")

    def _lose(self, error: Exception) -> None:
        """Give up a failed bus and schedule its opening."""
        self._drops_before = self._count_drops()
        self._bus = self._reader = None
        self._connection.lose(error)
        self._health.losses = self._connection.losses
        self._health.state = "gone"

    def _try_again(self, timeout_s: float) -> None:
        """Open the lost bus if an attempt is due, otherwise wait."""
        wait_s = self._connection.wait_s
        if wait_s > 0.0:
            self._sleep(min(wait_s, timeout_s))
            return
        bus = self._connection.try_again()
        if bus is None:
            return
        try:
            self._use(bus)
        except (can.CanError, OSError) as error:
            self._lose(error)

    def _recover(self, frame: Frame | None) -> None:
        """Record a read without an error after the bus was off."""
        health = self._health
        self._connection.received()
        health.reconnects = self._connection.reconnects
        if health.state == "gone" or frame is not None:
            health.state = "active"

    def send(self, frame: Frame) -> None:
        """Send a frame; count it as a transmit error if that fails."""
        try:
            if self._bus is None:
                raise can.CanOperationError("the bus is lost")
            self._bus.send(message_of(frame), timeout=0)
        except (can.CanError, OSError):
            self._health.transmit_errors += 1

    def close(self) -> None:
        """Shut down a bus that was opened again; the caller owns the first bus."""
        self._connection.close()
