"""One of the two buses of a gateway."""

import math
import socket
from typing import Final

import can

from monitor.bus.link.connection import Connection
from monitor.bus.link.socketcan import RECEIVE_BUFFER_BYTES

SEND_TIMEOUT_S: Final = 0.05


class Side:
    """A bus that is received from and sent to without its own frames, and opened again when lost.

    connection : holds the bus, which is open
    """

    def __init__(self, connection: Connection) -> None:
        self.name, self._connection = connection.name, connection
        assert connection.bus is not None
        self._use(connection.bus)

    def _use(self, bus: can.BusABC) -> None:
        self._is_socketcan = _set_up(bus)
        self.fileno = _fileno(bus)  # what to wait for, -1 if there is nothing

    @property
    def is_lost(self) -> bool:
        """Return whether the interface is gone."""
        return self._connection.is_lost

    @property
    def losses(self) -> int:
        """Return how often the interface went away."""
        return self._connection.losses

    @property
    def reconnects(self) -> int:
        """Return how often it came back."""
        return self._connection.reconnects

    @property
    def is_open(self) -> bool:
        """Return whether there is something to receive from."""
        return self._connection.bus is not None

    @property
    def wait_s(self) -> float:
        """Return how long it is until a lost interface is tried again, inf if it is open."""
        return math.inf if self.is_open else self._connection.wait_s

    def receive(self) -> can.Message | None:
        """Return the next message, None if none is there.

        Raises BusError when the interface fails and cannot be opened again.
        """
        connection = self._connection
        try:
            bus = connection.bus
            if bus is None:
                bus = connection.try_again()
                if bus is None:
                    return None
                self._use(bus)
            while (message := bus.recv(0.0)) and self._is_own(message):
                pass
        except (can.CanError, OSError) as error:
            connection.lose(error)
            return None
        if connection.is_lost:
            connection.received()
        return message

    def _is_own(self, message: can.Message) -> bool:
        """Return whether it is one that was sent here, on a bus opened to hear these.

        SocketCAN gives none, and calls what other processes of this machine send not received.
        """
        return not (message.is_rx or message.is_error_frame or self._is_socketcan)

    def send(self, message: can.Message) -> bool:
        """Send a message; return whether the interface took it."""
        bus = self._connection.bus
        if bus is None:
            return False
        try:
            bus.send(message, timeout=SEND_TIMEOUT_S)
        except (can.CanError, OSError, ValueError):
            return False
        return True

    def close(self) -> None:
        """Let go of a bus that was opened again; the first is its opener's."""
        self._connection.close()


def _fileno(bus: can.BusABC) -> int:
    try:
        return bus.fileno()
    except NotImplementedError:
        return -1


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
