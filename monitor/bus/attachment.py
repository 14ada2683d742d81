"""What may hang on the live loop beside the judging: transmitter, diagnostics, polling, views.

An attachment never waits: the loop's one thread calls it between two frames.
"""

from collections.abc import Collection, Iterable
from typing import Protocol

from monitor.base.types import Frame
from monitor.pipeline.events import Event


class Attachment(Protocol):
    """Takes what the loop sees and says what it wants to send."""

    @property
    def identifiers(self) -> Collection[tuple[int, bool]]:
        """Return the identifiers, and whether each has 29 bits, that it wants to receive."""

    @property
    def due_s(self) -> float:
        """Return the monotonic time at which ``work`` wants to be called, inf for none."""

    def receive(self, frame: Frame) -> Iterable[Frame]:
        """Take a frame under one of its identifiers; return frames for the pipeline to judge."""

    def push(self, event: Event) -> None:
        """Take an event of the pipeline; its change of the fault memory is stored by now."""

    def work(self, now_s: float) -> Iterable[Frame]:
        """Return the frames to be sent now; called when due, and after every receive and push."""

    def close(self) -> None:
        """Let go of what it holds."""
