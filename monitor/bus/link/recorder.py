"""The log of all frames that the loop judges, including the frames it makes itself."""

from contextlib import AbstractContextManager
from pathlib import Path
from queue import Queue
from threading import Thread
from typing import Final

import can

from monitor.base.errors import RecordingError
from monitor.base.types import Frame, FrameBlock
from monitor.frames.blocks import MAX_BYTES, frames_of
from monitor.frames.logs import log_kind
from monitor.frames.text.candump_lines import lines_of

WAITING: Final = 256  # most blocks that wait for the disk: 5 s and more, of a busy bus 25 s


class Recorder(AbstractContextManager["Recorder"]):
    """Writes every frame that the loop judges, in the same order; candump text names a channel.

    Raises RecordingError if the file cannot be created or its format cannot be replayed.
    """

    def __init__(self, path: Path, channel: str = "") -> None:
        self._path, self._channel = path, channel
        # refuses a format that cannot be replayed; python-can leaves CAN FD frames out of a .trc
        self._longest = 8 if log_kind(path) == ".trc" else MAX_BYTES
        try:
            self._text = path.open("wb") if path.suffix.lower() == ".log" else None
            self._writer = can.Logger(path) if self._text is None else None
        except (OSError, ValueError, NotImplementedError, ImportError) as error:
            raise RecordingError(f"{path}: cannot record: {error}") from None

    def write(self, block: FrameBlock) -> None:
        """Write frames, their times in whole microseconds.

        Raises RecordingError if the file cannot be written.
        """
        try:
            if self._text is not None:
                self._text.write(lines_of(block, self._channel))
                return
            assert self._writer is not None
            if block.length.max(initial=0) > self._longest:
                raise ValueError("a .trc log holds no CAN FD frames")
            for frame in frames_of(block):
                self._writer.on_message_received(message_of(frame))
        except (OSError, ValueError) as error:
            raise RecordingError(f"{self._path}: cannot record: {error}") from None

    def close(self) -> None:
        """Write the remaining frames and close; raises RecordingError on failure."""
        try:
            if self._text is not None:
                self._text.close()
            if self._writer is not None:
                self._writer.stop()
        except (OSError, ValueError) as error:
            raise RecordingError(f"{self._path}: cannot record: {error}") from None

    def __exit__(self, *_: object) -> None:
        self.close()


class LiveRecorder:
    """A recorder on a thread of its own, so that a disk that stalls delays no verdict.

    Raises as ``Recorder``; what cannot be written is told with the next block, or at the end.
    """

    def __init__(self, path: Path) -> None:
        self._recorder, self._failure = Recorder(path), list[Exception]()
        self._blocks: Queue[FrameBlock | None] = Queue(WAITING)
        self._thread = Thread(target=self._work, daemon=True)
        self._thread.start()

    def write(self, block: FrameBlock) -> None:
        """Let frames be written, none of which changes any more; waits where too many do."""
        for failure in self._failure:
            raise failure
        self._blocks.put(block)

    def close(self) -> None:
        """Write the remaining frames and close."""
        self._blocks.put(None)
        self._thread.join()
        self._recorder.close()
        for failure in self._failure:
            raise failure

    def _work(self) -> None:
        while (block := self._blocks.get()) is not None:
            try:
                if not self._failure:
                    self._recorder.write(block)
            except Exception as error:
                self._failure.append(error)


def message_of(frame: Frame) -> can.Message:
    """Return the frame as a message of python-can."""
    return can.Message(
        timestamp=frame.t_ns / 1e9,
        arbitration_id=frame.can_id,
        is_extended_id=frame.is_extended,
        data=frame.data,
        is_fd=len(frame.data) > 8,
    )
