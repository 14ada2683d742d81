"""The log of what the loop has seen, time marks and other frames of its own among it."""

from contextlib import AbstractContextManager
from pathlib import Path

import can

from monitor.base.errors import RecordingError
from monitor.base.types import Frame
from monitor.frames.logs import log_kind


class Recorder(AbstractContextManager["Recorder"]):
    """Writes every frame the loop has seen, in the order in which it has seen them.

    Raises RecordingError if the file cannot be made or its format could not be replayed.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        log_kind(path)  # what cannot be replayed is not recorded
        try:
            self._writer = can.Logger(path)
        except (OSError, ValueError, NotImplementedError, ImportError) as error:
            raise RecordingError(f"{path}: cannot record: {error}") from None

    def write(self, frame: Frame) -> None:
        """Write one frame with its time in whole microseconds.

        Raises RecordingError if the file cannot be written.
        """
        try:
            self._writer.on_message_received(message_of(frame))
        except (OSError, ValueError) as error:
            raise RecordingError(f"{self._path}: cannot record: {error}") from None

    def close(self) -> None:
        """Write what is left; raises RecordingError if that cannot be done."""
        try:
            self._writer.stop()
        except (OSError, ValueError) as error:
            raise RecordingError(f"{self._path}: cannot record: {error}") from None

    def __exit__(self, *_: object) -> None:
        self.close()


def message_of(frame: Frame) -> can.Message:
    """Return a frame as python-can's message."""
    return can.Message(
        timestamp=frame.t_ns / 1e9,
        arbitration_id=frame.can_id,
        is_extended_id=frame.is_extended,
        data=frame.data,
        is_fd=len(frame.data) > 8,
    )
