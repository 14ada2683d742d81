"""Reads the SocketCAN socket of a python-can bus, all frames that have gathered at once.

python-can's ``recv`` makes two system calls per frame, builds a Message and turns the kernel's
nanoseconds into a float. This reader lets frames gather in the kernel, which has stamped them
already, while none is urgent, and takes them with one call, recvmmsg(2), as arrays.
"""

import ctypes
import errno
import os
import select
import socket
import time
from typing import Any, Final

import can
import numpy as np

from monitor.base.types import FrameBlock
from monitor.bus.link.received import NOTHING, ErrorMessage, Received
from monitor.frames.blocks import chosen

SO_TIMESTAMPNS: Final = 35
SO_RXQ_OVFL: Final = 40
SO_RCVBUFFORCE: Final = 33
RECEIVE_BUFFER_BYTES: Final = 8 << 20  # the default holds about 320 frames
FRAMES: Final = 1024  # most in one call
BEHIND_S: Final = 0.0002  # so long behind a tick's end the frame is there that closes it

_IS_REMOTE, _IS_ERROR = 0x40000000, 0x20000000
# the kernel's structures: struct canfd_frame, whose begin is struct can_frame; struct iovec; struct
# mmsghdr; and the ancillary data, of which the number of drops comes only if there are any
_FRAME: Final = np.dtype(
    [("can_id", "u4"), ("length", "u1"), ("flags", "u1", 3), ("data", "u1", 64)]
)
_SIZES: Final = (16, 72)
_PART: Final = np.dtype([("base", np.uintp), ("n_bytes", np.uintp)])
_MESSAGE: Final = np.dtype(
    [
        ("name", np.uintp),
        ("name_bytes", np.uint32),
        ("parts", np.uintp),
        ("n_parts", np.uintp),
        ("control", np.uintp),
        ("control_bytes", np.uintp),
        ("flags", np.intc),
    ],
    align=True,
)
_HEADER: Final = np.dtype([("message", _MESSAGE), ("n_bytes", np.uintc)], align=True)
_KIND: Final = [("n_bytes", np.uintp), ("level", np.intc), ("kind", np.intc)]
_STAMP: Final = np.dtype([*_KIND, ("seconds", "l"), ("nanoseconds", "l")], align=True)
_DROPS: Final = np.dtype([*_KIND, ("n", np.uint32)], align=True)
_CONTROL: Final = np.dtype([("stamp", _STAMP), ("drops", _DROPS)], align=True)


class SocketReader:
    """Receives from the socket of a python-can bus."""

    def __init__(self, can_socket: socket.socket) -> None:
        self._socket = can_socket
        self.buffer_bytes = _enlarge(can_socket)
        self.drops: int | None = 0  # frames lost because the buffer was full, None if unknown
        try:
            can_socket.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        except OSError:  # an old kernel does not count drops
            self.drops = None
        self._recvmmsg = ctypes.CDLL(None, use_errno=True).recvmmsg
        self._is_full = False  # the last call took as many frames as it could
        places = np.arange(FRAMES, dtype=np.uintp)
        self._frames = np.zeros(FRAMES, dtype=_FRAME)
        self._control = np.zeros(FRAMES, dtype=_CONTROL)
        self._parts = np.zeros(FRAMES, dtype=_PART)
        self._parts["base"] = self._frames.ctypes.data + places * np.uintp(_FRAME.itemsize)
        self._parts["n_bytes"] = _FRAME.itemsize
        self._headers = np.zeros(FRAMES, dtype=_HEADER)
        self._address = ctypes.c_void_p(self._headers.ctypes.data)
        message = self._message = self._headers["message"]
        message["parts"] = self._parts.ctypes.data + places * np.uintp(_PART.itemsize)
        message["n_parts"] = 1
        message["control"] = self._control.ctypes.data + places * np.uintp(_CONTROL.itemsize)

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

    def receive(self, wait_s: float, tick_end_ns: int) -> Received:
        """Return what comes within ``wait_s``.

        tick_end_ns : wall-clock time before which no frame is urgent, so that others may gather
        Raises OSError if the interface fails.
        """
        if not self._is_full and not self._wait(wait_s, tick_end_ns):
            return NOTHING
        self._message["control_bytes"] = _CONTROL.itemsize
        n = self._recvmmsg(self._socket.fileno(), self._address, FRAMES, socket.MSG_DONTWAIT, None)
        self._is_full = n == FRAMES
        if n < 0:
            reason = ctypes.get_errno()
            if reason in (errno.EAGAIN, errno.EINTR):
                return NOTHING
            raise OSError(reason, os.strerror(reason))
        return self._received(n)

    def _wait(self, wait_s: float, tick_end_ns: int) -> bool:
        """Wait for a frame, and then for those that gather with it; return whether one came."""
        until_s = time.monotonic() + wait_s
        if not select.select([self._socket], [], [], wait_s)[0]:
            return False
        calm_s = (tick_end_ns - time.time_ns()) * 1e-9 + BEHIND_S
        calm_s = min(calm_s, until_s - time.monotonic())
        if calm_s > 0.0:
            time.sleep(calm_s)
        return True

    def _received(self, n: int) -> Received:
        """Return the first frames in the buffers."""
        frames, size, t_ns = self._frames[:n], self._headers["n_bytes"][:n], self._stamps(n)
        can_id, length = frames["can_id"].copy(), np.minimum(frames["length"], size - 8)
        length = length.astype(np.uint8)
        width = 8 if length.max(initial=0) <= 8 else 64
        data = frames["data"][:, :width].copy()
        if (length < width).any():
            data[np.arange(width) >= length[:, np.newaxis]] = 0
        whole = (size == _SIZES[0]) | (size == _SIZES[1])
        odd = (can_id & (_IS_ERROR | _IS_REMOTE) != 0) | ~whole
        block = FrameBlock(t_ns, can_id, length, data)  # the flag of 29 bits is that of a key
        if not odd.any():
            return Received(block)
        is_error = whole & (can_id & _IS_ERROR != 0)
        errors = [
            ErrorMessage(
                int(np.count_nonzero(~odd[:row])),
                int(can_id[row]) & 0x1FFFFFFF,
                data[row, : length[row]].tobytes(),
            )
            for row in np.flatnonzero(is_error).tolist()
        ]
        n_malformed = n - int(np.count_nonzero(whole))
        n_remote = int(np.count_nonzero(odd)) - len(errors) - n_malformed
        return Received(chosen(block, ~odd), errors, n_remote, n_malformed)

    def _stamps(self, n: int) -> Any:
        """Return the kernel's times of the first frames, (n,); note how many were dropped."""
        control, n_bytes = self._control[:n], self._message["control_bytes"][:n]
        stamp = control["stamp"]
        # whole microseconds, as in logs, so that a recording replays the same
        t_ns = stamp["seconds"] * 1_000_000_000 + (stamp["nanoseconds"] + 500) // 1000 * 1000
        told = np.flatnonzero(n_bytes > _STAMP.itemsize)
        if told.size:
            self.drops = int(control["drops"]["n"][told[-1]])
        return np.where(n_bytes >= _STAMP.itemsize, t_ns, 0)


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
