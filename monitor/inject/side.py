"""One of the two buses of a gateway."""

import socket
from typing import Any, Final

import can

from monitor.bus.link.connection import Connection
from monitor.bus.link.datagrams import Datagrams
from monitor.bus.link.socketcan import RECEIVE_BUFFER_BYTES

SEND_TIMEOUT_S: Final = 0.05


class Side(Connection):
    """A bus to receive from and send to; it drops its sent frames and is opened again after a loss.

    The arguments are those of a connection.
    """

    def __init__(self, bus: can.BusABC, *others: Any, **named: Any) -> None:
        super().__init__(bus, *others, **named)
        self.datagrams = Datagrams()

    def _use(self, bus: can.BusABC) -> None:
        self._is_socketcan = _set_up(bus)
        self.fileno = _fileno(bus)  # file descriptor to wait for, -1 if there is none

    def receive(self) -> can.Message | None:
        """Return the next message, None if none is waiting.

        Raises BusError if the interface fails and cannot be opened again.
        """
        try:
            if (bus := self.bus or self.try_again()) is None:
                return None
            while (message := bus.recv(0.0)) and self._is_own(message):
                pass
        except Exception as error:  # python-can's interfaces raise any, on any datagram
            if not self.datagrams.survives(error):
                self.lose(error)
            return None
        self.datagrams.read()
        if self.is_lost:
            self.received()
        return message

    def _is_own(self, message: can.Message) -> bool:
        """Return whether a message was sent by this process and heard back.

        SocketCAN gives no such message; it marks those of other local processes as not received.
        """
        return not (message.is_rx or message.is_error_frame or self._is_socketcan)

    def send(self, message: can.Message) -> bool:
        """Send a message; return whether the interface accepted it."""
        if self.bus is None:
            return False
        message.timestamp = 0.0  # of the other bus: some interfaces pass it on, or refuse it
        try:
            self.bus.send(message, timeout=SEND_TIMEOUT_S)
        except (can.CanError, OSError, ValueError):
            return False
        return True


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
