"""Reads the SocketCAN socket of a python-can bus.

python-can's ``recv`` makes two system calls per frame, builds a Message and turns the kernel's
nanoseconds into a float. This reader makes one call and keeps integer time. It also lets frames
gather in the kernel while none is urgent: the kernel has already stamped them.
"""

import select
import socket
import struct
import time
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import can

from monitor.base.types import Frame

SO_TIMESTAMPNS: Final = 35
SO_RXQ_OVFL: Final = 40
SO_RCVBUFFORCE: Final = 33
RECEIVE_BUFFER_BYTES: Final = 8 << 20  # the default holds about 320 frames
BLOCK_S: Final = 0.1  # longest wait in the kernel, so that a stop request is noticed
GATHER_S: Final = 0.02  # longest time frames gather; a diagnostic request waits no longer
AWAKE_S: Final = 0.002  # this long before a tick's end every frame is read at once

_FRAME: Final = struct.Struct("=IB3x")
_TIME: Final = struct.Struct("@ll")
_TIMEOUT: Final = struct.Struct("@ll")
_DROPS: Final = struct.Struct("@I")
_FRAME_BYTES: Final = 72  # struct canfd_frame
_ANCILLARY_BYTES: Final = socket.CMSG_SPACE(_TIME.size) + socket.CMSG_SPACE(_DROPS.size)
_IS_EXTENDED, _IS_REMOTE, _IS_ERROR = 0x80000000, 0x40000000, 0x20000000


class ErrorMessage(NamedTuple):
    """An error frame of SocketCAN."""

    can_id: int  # identifier without flags
    data: bytes


class SocketReader:
    """Receives from the socket of a python-can bus."""

    def __init__(self, can_socket: socket.socket) -> None:
        self._socket = can_socket
        self.buffer_bytes = _enlarge(can_socket)
        self.drops: int | None = 0  # frames lost because the buffer was full, None if unknown
        self.remote_frames = 0
        try:
            can_socket.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        except OSError:  # an old kernel does not count drops
            self.drops = None
        timeout = _TIMEOUT.pack(0, int(BLOCK_S * 1e6))
        can_socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, timeout)
        self._recvmsg = can_socket.recvmsg
        self._is_drained = True
        self._wall_ns: Callable[[], int] = time.time_ns

    @classmethod
    def of(cls, bus: can.BusABC) -> "SocketReader | None":
        """Return a reader for a SocketCAN bus with kernel timestamps, None for another bus."""
        can_socket = getattr(bus, "socket", None)
        if not isinstance(can_socket, socket.socket):
            return None
        try:
            stamped = can_socket.getsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS)
        except OSError:
            return None
        return cls(can_socket) if stamped else None

    def receive(self, timeout_s: float, tick_end_ns: int) -> Frame | ErrorMessage | None:
        """Return the next frame, None if none arrives in time.

        timeout_s : longest wait; at most ``BLOCK_S`` counts
        tick_end_ns : wall-clock time before which no frame is urgent
        Raises OSError if the interface fails.
        """
        flags = 0
        if not self._is_drained:
            flags = socket.MSG_DONTWAIT  # read the gathered frames first
        elif timeout_s < BLOCK_S:
            if not select.select([self._socket], [], [], timeout_s)[0]:
                return None
            flags = socket.MSG_DONTWAIT
        try:
            raw, ancillary, _, _ = self._recvmsg(_FRAME_BYTES, _ANCILLARY_BYTES, flags)
        except BlockingIOError:
            self._wait(timeout_s, tick_end_ns)
            return None
        self._is_drained = False
        return self._frame(raw, ancillary)

    def _wait(self, timeout_s: float, tick_end_ns: int) -> None:
        """Let frames gather until shortly before the tick's end; then the next call blocks."""
        if self._is_drained:
            return
        calm_s = (tick_end_ns - self._wall_ns()) * 1e-9 - AWAKE_S
        if calm_s > 0.0:
            time.sleep(min(calm_s, GATHER_S, timeout_s))
        else:
            self._is_drained = True

    def _frame(self, raw: bytes, ancillary: list[Any]) -> Frame | ErrorMessage | None:
        can_id, length = _FRAME.unpack_from(raw)
        t_ns = 0
        for _, kind, content in ancillary:
            if kind == SO_TIMESTAMPNS:
                seconds, nanoseconds = _TIME.unpack(content)
                # whole microseconds, as in logs, so that a recording replays the same
                t_ns = seconds * 1_000_000_000 + (nanoseconds + 500) // 1000 * 1000
            elif kind == SO_RXQ_OVFL:
                (self.drops,) = _DROPS.unpack(content)
        data = raw[8 : 8 + length]
        if can_id & _IS_EXTENDED:
            if not can_id & (_IS_ERROR | _IS_REMOTE):
                return Frame(t_ns, can_id & 0x1FFFFFFF, True, data)
        elif can_id < _IS_ERROR:
            return Frame(t_ns, can_id, False, data)
        if can_id & _IS_ERROR:
            return ErrorMessage(can_id & 0x1FFFFFFF, data)
        self.remote_frames += 1
        return None


def _enlarge(can_socket: socket.socket) -> int:
    """Request a larger receive buffer, first with force; return its size in bytes."""
    for option in (SO_RCVBUFFORCE, socket.SO_RCVBUF):
        try:
            can_socket.setsockopt(socket.SOL_SOCKET, option, RECEIVE_BUFFER_BYTES)
            break
        except OSError:  # not permitted
            continue
    size = can_socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    return size // 2  # the kernel reports twice the size
