"""A CAN bus between processes on a kernel without one: struct can_frame over UDP on loopback.

The kernel stamps each datagram and counts those lost in a full buffer, as on a CAN socket. So the
monitor's SocketCAN reader runs on it, and python-can's, too: ``recv`` here is the code of its
SocketCAN interface. There are no kernel filters; send only frames that they would pass.
"""

import select
import socket
from typing import Any

import can
from can.interfaces.socketcan import socketcan
from can.interfaces.socketcan.constants import SO_TIMESTAMPNS

Address = tuple[str, int]


class UdpCan(can.BusABC):
    """One node; what it sends goes to one other."""

    def __init__(self, peer: Address | None = None, own: Address = ("127.0.0.1", 0)) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self.socket.bind(own)
        self.peer = peer
        self.channel_info = f"struct can_frame over UDP at port {self.address[1]}"
        super().__init__(channel="udp")

    @property
    def address(self) -> Address:
        host, port = self.socket.getsockname()
        return host, port

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        try:  # as in SocketcanBus
            ready, _, _ = select.select([self.socket], [], [], timeout)
        except OSError as error:
            raise can.CanOperationError(
                f"Failed to receive: {error.strerror}", error.errno
            ) from error
        return (socketcan.capture_message(self.socket), True) if ready else (None, True)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.send_raw(socketcan.build_can_frame(msg))

    def send_raw(self, frame: bytes) -> None:
        """Send a struct can_frame or canfd_frame."""
        if self.peer:
            self.socket.sendto(frame, self.peer)

    def _apply_filters(self, filters: Any) -> None:
        """The kernel would; see above."""

    def shutdown(self) -> None:
        super().shutdown()
        self.socket.close()
