"""Reads a SocketCAN socket that python-can has opened.

python-can's own ``recv`` costs two system calls a frame, makes a Message and brings the kernel's
nanoseconds to a float. This one costs one call and keeps the time an integer, and it lets frames
gather in the kernel while nothing waits for them: the kernel has stamped them already.
"""

import select
import socket
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final, NamedTuple

import can

from monitor.base.types import Frame

SO_TIMESTAMPNS: Final = 35
SO_RXQ_OVFL: Final = 40
SO_RCVBUFFORCE: Final = 33
RECEIVE_BUFFER_BYTES: Final = 8 << 20  # the default holds about 320 frames
BLOCK_S: Final = 0.1  # longest wait in the kernel, so that a request to stop is heard
GATHER_S: Final = 0.02  # longest time for which frames gather: a diagnostic request waits no longer
AWAKE_S: Final = 0.002  # before the end of a tick from which every frame is read as it comes

_FRAME: Final = struct.Struct("=IB3x")
_TIME: Final = struct.Struct("@ll")
_TIMEOUT: Final = struct.Struct("@ll")
_DROPS: Final = struct.Struct("@I")
_FRAME_BYTES: Final = 72  # struct canfd_frame
_ANCILLARY_BYTES: Final = socket.CMSG_SPACE(_TIME.size) + socket.CMSG_SPACE(_DROPS.size)
_IS_EXTENDED, _IS_REMOTE, _IS_ERROR = 0x80000000, 0x40000000, 0x20000000


class ErrorMessage(NamedTuple):
    """An error frame as it came."""

    can_id: int  # without flags
    data: bytes


class SocketReader:
    """Receives from the socket of a python-can bus."""

    def __init__(self, own: socket.socket) -> None:
        self._socket = own
        self.buffer_bytes = _enlarge(own)
        self.drops = 0  # frames that the socket had no room for
        self.remote_frames = 0
        with suppress(OSError):  # an old kernel does not count drops
            own.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        own.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _TIMEOUT.pack(0, int(BLOCK_S * 1e6)))
        self._recvmsg = own.recvmsg
        self._is_drained = True
        self._wall_ns: Callable[[], int] = time.time_ns

    @classmethod
    def of(cls, bus: can.BusABC) -> "SocketReader | None":
        """Return a reader for the bus, None if it is not SocketCAN with kernel timestamps."""
        own = getattr(bus, "socket", None)
        if not isinstance(own, socket.socket):
            return None
        try:
            stamped = own.getsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS)
        except OSError:
            return None
        return cls(own) if stamped else None

    def receive(self, timeout_s: float, tick_end_ns: int) -> Frame | ErrorMessage | None:
        """Return the next frame, None if none came in time.

        timeout_s : at most ``BLOCK_S`` counts
        tick_end_ns : wall time before which nobody waits for a frame
        Raises OSError when the interface fails.
        """
        flags = 0
        if not self._is_drained:
            flags = socket.MSG_DONTWAIT  # first what is there
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
        """Let frames gather if nobody waits for one; the next call blocks otherwise."""
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
                # whole microseconds, as logs have them, so that a recording replays the same
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


def _enlarge(own: socket.socket) -> int:
    """Ask for a larger receive buffer, with force first; return the bytes that were got."""
    for option in (SO_RCVBUFFORCE, socket.SO_RCVBUF):
        try:
            own.setsockopt(socket.SOL_SOCKET, option, RECEIVE_BUFFER_BYTES)
            break
        except OSError:  # not permitted
            continue
    return own.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2  # the kernel doubles it
