"""What ``o2mon run`` prints while it runs."""

import math
from collections.abc import Callable

from monitor.pipeline import Event, Tick
from monitor.sinks import Collector, event_line
from monitor.types import Frame


class Lines:
    """One line for every window and every changed code: what a service's journal wants."""

    identifiers: tuple[tuple[int, bool], ...] = ()
    due_s = math.inf

    def __init__(self, collector: Collector, say: Callable[[str], None]) -> None:
        self._collector, self._say = collector, say

    def receive(self, _: Frame) -> tuple[Frame, ...]:
        """Return nothing: no frame is wanted."""
        return ()

    def push(self, event: Event) -> None:
        """Print an event that is no tick."""
        if not isinstance(event, Tick):
            self._say(event_line(event, self._collector))

    def work(self, _: float) -> tuple[Frame, ...]:
        """Return nothing: no frame is sent."""
        return ()

    def close(self) -> None:
        """Nothing is held."""
