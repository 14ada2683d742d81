"""Attachments of the live loop: transmitter, diagnostics, polling and views.

An attachment never waits, because the loop's only thread calls it between two blocks of frames.
"""

import math
from collections.abc import Collection, Iterable

from monitor.base.types import Frame
from monitor.pipeline.events import Event


class Attachment:
    """Takes frames and events of the loop, and returns frames to send; this one does nothing."""

    @property
    def identifiers(self) -> Collection[tuple[int, bool]]:
        """Return the identifiers of the frames it receives, and whether each has 29 bits."""
        return ()

    @property
    def due_s(self) -> float:
        """Return the monotonic time in s of the next call of ``work``, inf for none."""
        return math.inf

    def receive(self, frame: Frame) -> None:
        """Take a frame under one of its identifiers."""

    def push(self, event: Event) -> None:
        """Take an event of the pipeline; its change of the fault memory is already stored."""

    def work(self, now_s: float) -> Iterable[Frame]:
        """Return the frames to send now; called when due, and after every receive and push."""
        return ()

    def close(self) -> None:
        """Release its resources."""
