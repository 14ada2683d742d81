"""The log of all frames that the loop judges, including the frames it makes itself."""

from contextlib import AbstractContextManager
from pathlib import Path

import can

from monitor.base.errors import RecordingError
from monitor.base.types import Frame
from monitor.frames.logs import log_kind


class Recorder(AbstractContextManager["Recorder"]):
    """Writes every frame that the loop judges, in the same order.

    Raises RecordingError if the file cannot be created or its format cannot be replayed.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        log_kind(path)  # refuses a format that cannot be replayed
        try:
            self._writer = can.Logger(path)
        except (OSError, ValueError, NotImplementedError, ImportError) as error:
            raise RecordingError(f"{path}: cannot record: {error}") from None

    def write(self, frame: Frame) -> None:
        """Write one frame, its time in whole microseconds.

        Raises RecordingError if the file cannot be written.
        """
        try:
            self._writer.on_message_received(message_of(frame))
        except (OSError, ValueError) as error:
            raise RecordingError(f"{self._path}: cannot record: {error}") from None

    def close(self) -> None:
        """Write the remaining frames and close; raises RecordingError on failure."""
        try:
            self._writer.stop()
        except (OSError, ValueError) as error:
            raise RecordingError(f"{self._path}: cannot record: {error}") from None

    def __exit__(self, *_: object) -> None:
        self.close()


def message_of(frame: Frame) -> can.Message:
    """Return the frame as a message of python-can."""
    return can.Message(
        timestamp=frame.t_ns / 1e9,
        arbitration_id=frame.can_id,
        is_extended_id=frame.is_extended,
        data=frame.data,
        is_fd=len(frame.data) > 8,
    )
