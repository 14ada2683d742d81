"""What one look at a bus brings, and the reader of interfaces that give single messages."""

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import can

from monitor.base.types import Frame, FrameBlock
from monitor.bus.link.datagrams import Datagrams
from monitor.frames.blocks import block_of
from monitor.frames.logs import frame_of

MESSAGES: Final = 1024  # most in a block


class ErrorMessage(NamedTuple):
    """An error frame."""

    place: int  # number of the block's frames before it
    can_id: int  # identifier without flags
    data: bytes


class Received(NamedTuple):
    """Frames in the order of their arrival, and what came among them."""

    block: FrameBlock
    errors: Sequence[ErrorMessage] = ()
    remote: int = 0  # remote frames
    malformed: int = 0  # datagrams that the interface could not read


NOTHING: Final = Received(block_of([]))


class MessageReader:
    """Receives messages from any bus of python-can.

    monotonic_s : clock for the time that a block takes, in s
    """

    drops: int | None = None  # nobody counts them

    def __init__(self, bus: can.BusABC, monotonic_s: Callable[[], float]) -> None:
        self._bus, self._now_s = bus, monotonic_s
        self._datagrams = Datagrams()
        self._failure: Exception | None = None

    def receive(self, wait_s: float, tick_end_ns: int) -> Received:
        """Return what comes within ``wait_s``, up to the first frame behind a tick's end.

        Raises what the interface raises if it fails.
        """
        if self._failure is not None:
            raise self._failure
        frames: list[Frame] = []
        errors: list[ErrorMessage] = []
        remote, before = 0, self._datagrams.malformed
        until_s = self._now_s() + wait_s
        while len(frames) + len(errors) + remote < MESSAGES:
            try:
                message = self._bus.recv(max(until_s - self._now_s(), 0.0))
                frame = None if message is None else frame_of(message)
            except Exception as error:  # python-can's interfaces raise any, on any datagram
                if self._datagrams.survives(error):
                    break
                self._failure = error  # behind what was received before it
                if not (frames or errors or remote):
                    raise
                break
            self._datagrams.read()
            if message is None or frame is None:
                break
            if message.is_error_frame:
                errors.append(ErrorMessage(len(frames), frame.can_id, frame.data))
            elif message.is_remote_frame:
                remote += 1
            else:
                frames.append(frame)
                if frame.t_ns > tick_end_ns:
                    break
        return Received(block_of(frames), errors, remote, self._datagrams.malformed - before)
