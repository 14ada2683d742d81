"""The attachment that hands events to the sinks, and their counters to the loop's health."""

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from typing import Any, Final

from monitor.base.types import Frame
from monitor.bus.attachment import Attachment
from monitor.bus.link.port import BusHealth
from monitor.pipeline.events import Event
from monitor.sinks.outlet import Outlet
from monitor.sinks.record import Record
from monitor.sinks.stream import Stream

LOOK_S: Final = 1.0  # between two looks at the counters
HEALTH_S: Final = 10.0  # between two records of the bus's health


class SinkFeed(Attachment):
    """Turns events into records and queues them; the outlets' threads write.

    health : takes the counters of all sinks, and is a record itself from time to time
    say : receives messages about lost and regained sinks
    """

    due_s = -math.inf

    def __init__(
        self,
        stream: Stream,
        outlets: Sequence[Outlet],
        health: BusHealth,
        say: Callable[[str], None],
    ) -> None:
        self._stream, self._outlets, self._health, self._say = stream, outlets, health, say
        self._health_due_s = -math.inf

    def push(self, event: Event) -> None:
        """Queue the records of an event."""
        for record in self._stream.push(event):
            self._put(record)

    def work(self, now_s: float) -> Iterable[Frame]:
        """Look at the counters if it is time."""
        if now_s >= self.due_s:
            self.due_s = now_s + LOOK_S
            self._look()
        if now_s >= self._health_due_s:
            self._health_due_s = now_s + HEALTH_S
            self._put(health_record(self._health))
        return ()

    def close(self) -> None:
        """Write the remaining records, with the health at the end."""
        self._put(health_record(self._health))
        for outlet in self._outlets:
            outlet.end()
        for outlet in self._outlets:
            outlet.close()
        self._look()

    def entries(self) -> list[dict[str, Any]]:
        """Return state and counters of every sink."""
        return [outlet.entry() for outlet in self._outlets]

    def _put(self, record: Record) -> None:
        for outlet in self._outlets:
            outlet.put(record)

    def _look(self) -> None:
        health, outlets = self._health, self._outlets
        health.sinks_off = tuple(each.name for each in outlets if each.state == "lost")
        health.sinks_sent = sum(each.sent for each in outlets)
        health.sinks_dropped = sum(each.dropped for each in outlets)
        health.sinks_lost = sum(each.lost for each in outlets)
        for outlet in outlets:
            for note in outlet.notes():
                self._say(note)


def health_record(health: BusHealth) -> Record:
    """Return the bus's counters and state; names in one text, unknown counters left out."""
    fields = {name: value for name, value in asdict(health).items() if value is not None}
    flat = {k: " ".join(v) if isinstance(v, tuple) else v for k, v in fields.items()}
    return Record("health", time.time_ns(), flat)
