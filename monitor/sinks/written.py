"""The way from a replay to its sinks: the replay waits, and an error ends it."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack

from monitor.base.foreign import foreign
from monitor.pipeline.events import BlockEvent, singly
from monitor.pipeline.monitor import SensorMonitor
from monitor.sinks.outlet import BATCH
from monitor.sinks.record import Record, Sink
from monitor.sinks.stream import Stream

Listener = Callable[[BlockEvent], None]


class Written:
    """Sinks, each with the name that messages show.

    rate_hz : most "signals" records per second of the recording's time
    """

    def __init__(self, sinks: Sequence[tuple[str, Sink]], rate_hz: float) -> None:
        self._sinks, self._rate_hz = sinks, rate_hz
        self._waiting: list[Record] = []

    def listener(self, monitor: SensorMonitor) -> Listener:
        """Return the function that takes the events of one recording."""
        stream = Stream(monitor, self._rate_hz)

        def listen(event: BlockEvent) -> None:
            for each in singly(event):
                self._waiting.extend(stream.push(each))
                if len(self._waiting) >= BATCH:
                    self._write()

        return listen

    def close(self) -> None:
        """Write the remaining records and close the sinks; raises ForeignError if one fails."""
        with ExitStack() as ends:  # every sink is closed, also where one fails
            for name, sink in reversed(self._sinks):
                ends.callback(foreign(f"--sink {name}")(sink.close))
            self._write()

    def _write(self) -> None:
        records, self._waiting = self._waiting, []
        for name, sink in self._sinks if records else ():
            with foreign(f"--sink {name}"):
                sink.write(records)
