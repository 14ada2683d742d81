"""The way from the live loop to a sink: a bounded queue, and a thread that writes.

The loop only appends. What the sink does not take stays in the queue; when that is full the oldest
records are dropped and counted. After an error the sink is closed and tried again.
"""

import math
import threading
from collections import deque
from collections.abc import Callable
from typing import Final, Literal

from monitor.sinks.record import Record, RefusedError, Sink

QUEUED: Final = 10_000  # records; at one a second nearly three hours without a connection
BATCH: Final = 500  # most records of one write
FLUSH_S: Final = 0.5  # between two looks into the queue
AGAIN_S: Final = 1.0  # wait after the first error; it doubles with each error in a row
AGAIN_MOST_S: Final = 30.0
END_S: Final = 3.0  # time for the last records at the end

State = Literal["idle", "connected", "lost"]


class Outlet:
    """One sink with its queue and its thread; ``put`` is for one thread only.

    name : of the sink in messages and counters, without a password
    queued : most records that wait
    again_s, flush_s : first wait after an error, wait between two looks into the queue
    """

    def __init__(
        self,
        name: str,
        sink: Sink,
        *,
        queued: int = QUEUED,
        again_s: float = AGAIN_S,
        flush_s: float = FLUSH_S,
    ) -> None:
        self.name, self._sink = name, sink
        self._most, self._again_s, self._flush_s = queued, again_s, flush_s
        self._queue: deque[Record] = deque()
        self._batch: list[Record] = []  # taken from the queue, not written yet
        self._notes: deque[str] = deque(maxlen=10)
        self._ended = threading.Event()
        self.state: State = "idle"
        self.sent = self.dropped = self.lost = 0
        self._thread = threading.Thread(target=self._work, name=f"sink {name}", daemon=True)
        self._thread.start()

    def put(self, record: Record) -> None:
        """Queue a record; never waits."""
        self._queue.append(record)
        while len(self._queue) > self._most:
            try:
                self._queue.popleft()
            except IndexError:  # the thread took it first
                break
            self.dropped += 1

    def notes(self) -> list[str]:
        """Return the news of the connection since the last call."""
        said = []
        while self._notes:
            said.append(self._notes.popleft())
        return said

    def end(self) -> None:
        """Let the thread write the remaining records and end."""
        self._ended.set()

    def close(self) -> None:
        """Wait for the thread at most ``END_S``; records not written by then count as dropped."""
        self.end()
        self._thread.join(END_S)
        if self._thread.is_alive():  # the process may end, the thread is a daemon
            self._notes.append(f"sink {self.name} did not end within {END_S:g} s")
        self.dropped += len(self._queue) + len(self._batch)

    def entry(self) -> dict[str, str | int]:
        """Return name, state and counters as the JSON shows them."""
        return {
            "sink": self.name,
            "state": self.state,
            "sent": self.sent,
            "dropped": self.dropped,
            "lost": self.lost,
        }

    def _work(self) -> None:
        wait_s = self._flush_s
        while not self._ended.wait(wait_s):
            wait_s = self._flush_s if self._drain() else self._after_error()
        self._drain()
        self._quietly(self._sink.close)

    def _drain(self) -> bool:
        """Write all that waits; return whether the sink took it."""
        while self._take():
            try:
                self._sink.write(self._batch)
            except RefusedError as error:
                self._refuse(error)
                continue
            except Exception as error:  # whatever a library or a plug-in raises
                self._lose(error)
                return False
            self.sent += len(self._batch)
            self._batch = []
            if self.state == "lost":
                self._notes.append(f"sink {self.name} takes records again")
            self.state, self._errors, self._is_refusing = "connected", 0, False
        return True

    _errors = 0  # in a row
    _is_refusing = False

    def _take(self) -> bool:
        while self._queue and len(self._batch) < BATCH:
            try:
                self._batch.append(self._queue.popleft())
            except IndexError:  # dropped by the loop meanwhile
                break
        return bool(self._batch)

    def _refuse(self, error: RefusedError) -> None:
        if not self._is_refusing:
            self._notes.append(f"sink {self.name} refuses records: {error}")
        self._is_refusing = True
        self.dropped += len(self._batch)
        self._batch = []

    def _lose(self, error: Exception) -> None:
        if self.state != "lost":
            self.lost += 1
            reason = str(error) or type(error).__name__
            self._notes.append(f"sink {self.name} takes nothing: {reason}; it is tried again")
        self.state = "lost"
        self._errors += 1
        self._quietly(self._sink.close)

    def _after_error(self) -> float:
        return min(self._again_s * math.ldexp(1.0, min(self._errors - 1, 30)), AGAIN_MOST_S)

    def _quietly(self, call: Callable[[], None]) -> None:
        try:
            call()
        except Exception as error:
            self._notes.append(f"sink {self.name} did not close: {error}")
