"""One of the two buses of a gateway."""

import math
import socket
from typing import Final

import can

from monitor.bus.link.connection import Connection
from monitor.bus.link.datagrams import Datagrams
from monitor.bus.link.socketcan import RECEIVE_BUFFER_BYTES

SEND_TIMEOUT_S: Final = 0.05


class Side:
    """A bus to receive from and send to; it drops its sent frames and is opened again after a loss.

    connection : connection to the open bus
    """

    def __init__(self, connection: Connection) -> None:
        self.name, self.connection = connection.name, connection
        self.datagrams = Datagrams()
        assert connection.bus is not None
        self._use(connection.bus)

    def _use(self, bus: can.BusABC) -> None:
        self._is_socketcan = _set_up(bus)
        self.fileno = _fileno(bus)  # file descriptor to wait for, -1 if there is none

    @property
    def is_open(self) -> bool:
        """Return whether the bus is open."""
        return self.connection.bus is not None

    @property
    def wait_s(self) -> float:
        """Return the time in s until a lost interface is opened again, inf if it is open."""
        return math.inf if self.is_open else self.connection.wait_s

    def receive(self) -> can.Message | None:
        """Return the next message, None if none is waiting.

        Raises BusError if the interface fails and cannot be opened again.
        """
        connection = self.connection
        try:
            bus = connection.bus
            if bus is None:
                bus = connection.try_again()
                if bus is None:
                    return None
                self._use(bus)
            while (message := bus.recv(0.0)) and self._is_own(message):
                pass
        except Exception as error:  # python-can's interfaces raise any, on any datagram
            if not self.datagrams.survives(error):
                connection.lose(error)
            return None
        self.datagrams.read()
        if connection.is_lost:
            connection.received()
        return message

    def _is_own(self, message: can.Message) -> bool:
        """Return whether a message was sent by this process and heard back.

        SocketCAN gives no such message; it marks those of other local processes as not received.
        """
        return not (message.is_rx or message.is_error_frame or self._is_socketcan)

    def send(self, message: can.Message) -> bool:
        """Send a message; return whether the interface accepted it."""
        bus = self.connection.bus
        if bus is None:
            return False
        try:
            bus.send(message, timeout=SEND_TIMEOUT_S)
        except (can.CanError, OSError, ValueError):
            return False
        return True

    def close(self) -> None:
        """Shut down a bus that was opened again; the caller owns the first bus."""
        self.connection.close()


def _fileno(bus: can.BusABC) -> int:
    try:
        return bus.fileno()
    except NotImplementedError:
        return -1


def _set_up(bus: can.BusABC) -> bool:
    """Enlarge the buffer of a SocketCAN socket and stop it from hearing its sent frames.

    Returns whether the bus is SocketCAN; other interfaces stay unchanged.
    """
    can_socket = getattr(bus, "socket", None)
    if not isinstance(can_socket, socket.socket):
        return False
    can_socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
    if can_socket.family == getattr(socket, "AF_CAN", None):
        can_socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_RECV_OWN_MSGS, 0)
        return True
    return False
