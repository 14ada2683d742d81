"""The bus of the live loop: receiving, sending, filters and how well it is."""

import socket
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

import can

from monitor.errors import BusError
from monitor.recorder import message_of
from monitor.sources import frame_of
from monitor.types import Frame

RECEIVE_BUFFER_BYTES: Final = 8 << 20  # the default holds about 320 frames


@dataclass(slots=True)
class BusHealth:
    """What the loop counts beside the frames it judges."""

    frames: int = 0
    error_frames: int = 0
    remote_frames: int = 0
    transmit_errors: int = 0
    memory_errors: int = 0  # the fault memory could not be stored
    detached: int = 0  # attachments that raised and were let go


class Port:
    """One bus, received from by one thread.

    health : is kept up to date
    """

    def __init__(self, bus: can.BusABC, health: BusHealth) -> None:
        self._bus, self._health = bus, health
        enlarge_receive_buffer(bus)

    def set_filters(self, identifiers: Collection[tuple[int, bool]]) -> None:
        """Receive nothing but these identifiers, each with whether it has 29 bits."""
        self._bus.set_filters(
            [
                {
                    "can_id": can_id,
                    "can_mask": 0x1FFFFFFF if extended else 0x7FF,
                    "extended": extended,
                }
                for can_id, extended in identifiers
            ]
        )

    def receive(self, timeout_s: float) -> Frame | None:
        """Return the next frame, None if none came in time.

        Raises BusError when the interface fails.
        """
        message = receive(self._bus, timeout_s)
        if message is None:
            return None
        if message.is_error_frame:
            self._health.error_frames += 1
            return None
        if message.is_remote_frame:
            self._health.remote_frames += 1
            return None
        self._health.frames += 1
        return frame_of(message)

    def send(self, frame: Frame) -> None:
        """Send a frame or count that it could not be sent."""
        try:
            self._bus.send(message_of(frame), timeout=0)
        except (can.CanError, OSError):
            self._health.transmit_errors += 1


def enlarge_receive_buffer(bus: can.BusABC) -> None:
    """Give SocketCAN's socket room for seconds of traffic; other interfaces keep theirs."""
    own = getattr(bus, "socket", None)
    if isinstance(own, socket.socket):
        own.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)


def receive(bus: can.BusABC, timeout_s: float) -> can.Message | None:
    """Return the next message, None if none came in time.

    Raises BusError when the interface fails.
    """
    try:
        return bus.recv(timeout_s)
    except (can.CanError, OSError) as error:
        raise BusError(f"{bus.channel_info}: {error}") from None
