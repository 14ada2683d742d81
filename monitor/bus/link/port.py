"""The bus of the live loop: received from, sent to, watched, and opened again when it is lost."""

import math
import time
from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass
from typing import Any, Final, Literal

import can

from monitor.base.types import Frame
from monitor.bus.link.connection import Connection
from monitor.bus.link.error_frames import error_frame
from monitor.bus.link.recorder import message_of
from monitor.bus.link.socketcan import ErrorMessage, SocketReader
from monitor.frames.logs import frame_of

QUIET_S: Final = 10.0  # between two lines about the controller's state

State = Literal["active", "warning", "passive", "bus off", "gone"]
OFF: Final = ("bus off", "gone")


@dataclass(slots=True)
class BusHealth:
    """How the bus and the loop on it are."""

    state: State = "active"  # of the controller; "gone": the interface itself
    frames: int = 0  # received and not refused below
    error_frames: int = 0
    remote_frames: int = 0
    refused: int = 0  # frames under identifiers that the loop keeps for itself
    overruns: int = 0  # error frames that say the controller has lost frames
    drops: int = 0  # frames that the socket's buffer had no room for
    bus_off: int = 0  # times the controller went off the bus
    passive: int = 0  # times it became error passive
    warning: int = 0  # times its error counters reached the warning limit
    unacknowledged: int = 0  # error frames that say nobody acknowledges
    losses: int = 0  # times the interface went away
    reconnects: int = 0  # times it came back
    transmit_errors: int = 0
    stale: tuple[str, ...] = ()  # signals that no frame brings any more, now
    stale_samples: int = 0  # samples with such a signal
    memory_errors: int = 0  # times the fault memory could not be stored
    detached: int = 0  # attachments that raised and were let go
    receive_buffer_bytes: int = 0  # of SocketCAN, 0 if not known
    timestamps: Literal["kernel", "interface"] = "interface"

    def as_dict(self) -> dict[str, Any]:
        """Return the counters by name."""
        return asdict(self)


class Port:
    """One bus, received from by one thread.

    health : is kept up to date
    reopen : opens the bus again after it was lost; without it a loss is an error
    say : takes the lines about losses
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
        self._drops_before = 0  # on sockets that are closed
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

    @property
    def is_off(self) -> bool:
        """Return whether the monitor itself cannot hear the bus."""
        return self._health.state in OFF

    def set_filters(self, identifiers: Collection[tuple[int, bool]]) -> None:
        """Receive nothing but these identifiers, each with whether it has 29 bits."""
        self._filters = [
            {"can_id": can_id, "can_mask": 0x1FFFFFFF if long else 0x7FF, "extended": long}
            for can_id, long in sorted(identifiers)
        ]
        if self._bus:
            self._bus.set_filters(self._filters)

    def receive(self, timeout_s: float, tick_end_ns: int = 0) -> Frame | None:
        """Return the next frame, None if none came in time.

        tick_end_ns : bus time before which nobody waits for a frame, so that frames may gather
        Raises BusError when the interface fails and cannot be opened again.
        """
        if self._bus is None:
            self._try_again(timeout_s)
            return None
        try:
            if self._reader:
                frame = self._read(self._reader, timeout_s, tick_end_ns)
            else:
                frame = self._take(self._bus.recv(timeout_s))
        except (can.CanError, OSError) as error:
            self._lose(error)
            return None
        if self._health.state in OFF:
            self._recover(frame)
        return frame

    def _read(self, reader: SocketReader, timeout_s: float, tick_end_ns: int) -> Frame | None:
        got = reader.receive(timeout_s, tick_end_ns)
        if type(got) is Frame:
            self._health.frames += 1
            return got
        self._health.remote_frames = reader.remote_frames
        self._health.drops = self._drops_before + reader.drops
        if type(got) is ErrorMessage:
            self._heed(got.can_id, got.data)
        return None

    def _take(self, message: can.Message | None) -> Frame | None:
        if message is None:
            return None
        if message.is_error_frame and self._is_socketcan:
            self._heed(message.arbitration_id, bytes(message.data))
        elif message.is_error_frame:  # every other interface has a form of its own
            self._health.error_frames += 1
        elif message.is_remote_frame:
            self._health.remote_frames += 1
        else:
            self._health.frames += 1
            return frame_of(message)
        return None

    def _heed(self, can_id: int, data: bytes) -> None:
        """Take an error frame."""
        health, said = self._health, error_frame(can_id, data)
        if health.state == "gone":
            self._recover(None)
        health.error_frames += 1
        health.overruns += said.overflow
        health.unacknowledged += said.no_acknowledge
        if said.state is None or said.state == health.state:
            return
        health.state = said.state
        health.bus_off += said.state == "bus off"
        health.passive += said.state == "passive"
        health.warning += said.state == "warning"
        if said.state in ("bus off", "passive") and self._now_s() >= self._quiet_until_s:
            self._quiet_until_s = self._now_s() + QUIET_S
            self._say(f"bus: the controller is {'error ' * (said.state == 'passive')}{said.state}")

    def _lose(self, error: Exception) -> None:
        """Let go of a bus that has failed."""
        if self._reader:
            self._drops_before += self._reader.drops
        self._bus = self._reader = None
        self._connection.lose(error)
        self._health.losses = self._connection.losses
        self._health.state = "gone"

    def _try_again(self, timeout_s: float) -> None:
        """Wait for the next try, or make it."""
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
        """Note that a bus that was off has been read from without an error."""
        health = self._health
        self._connection.received()
        health.reconnects = self._connection.reconnects
        if health.state == "gone" or frame is not None:
            health.state = "active"

    def send(self, frame: Frame) -> None:
        """Send a frame or count that it could not be sent."""
        try:
            if self._bus is None:
                raise can.CanOperationError("the bus is lost")
            self._bus.send(message_of(frame), timeout=0)
        except (can.CanError, OSError):
            self._health.transmit_errors += 1

    def close(self) -> None:
        """Let go of a bus that was opened again; the first is its opener's."""
        self._connection.close()
