"""The way from the live loop to a sink: a bounded queue, and a thread that writes.

The loop only appends. What the sink does not take stays in the queue; when that is full the oldest
records are dropped and counted. After an error the sink is closed and tried again.
"""

import threading
from collections import deque
from collections.abc import Callable
from typing import Final, Literal

from monitor.base.foreign import ForeignError, foreign, one_line
from monitor.sinks.record import Record, Sink

QUEUED: Final = 10_000  # records; at one a second nearly three hours without a connection
BATCH: Final = 500  # most records of one write
FLUSH_S: Final = 0.5  # between two looks into the queue
AGAIN_S: Final = 1.0  # wait after the first error; it doubles with each error in a row
AGAIN_MOST_S: Final = 30.0
END_S: Final = 3.0  # time for the last records at the end

State = Literal["idle", "connected", "lost"]


class Outlet:
    """One sink with its queue and its thread.

    name : of the sink in messages and counters, without a password
    """

    def __init__(self, name: str, sink: Sink) -> None:
        self.name, self._sink = name, sink
        self._lock = threading.Lock()  # held for moments, never while the sink writes
        self._queue: deque[Record] = deque(maxlen=QUEUED)
        self._batch: list[Record] = []  # taken from the queue, not written yet
        self._notes: deque[str] = deque(maxlen=10)
        self._ended = threading.Event()
        self.state: State = "idle"
        self.sent = self.dropped = self.lost = 0
        self._thread = threading.Thread(target=self._work, name=f"sink {name}", daemon=True)
        self._thread.start()

    def put(self, record: Record) -> None:
        """Queue a record; never waits for the sink."""
        with self._lock:
            self.dropped += len(self._queue) == self._queue.maxlen
            self._queue.append(record)

    def notes(self) -> list[str]:
        """Return the news of the connection since the last call."""
        return [self._notes.popleft() for _ in range(len(self._notes))]

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
        counters = {"sent": self.sent, "dropped": self.dropped, "lost": self.lost}
        return {"sink": self.name, "state": self.state, **counters}

    def _work(self) -> None:
        wait_s, n_errors = FLUSH_S, 0
        while not self._ended.wait(wait_s):
            n_errors = 0 if self._drain() else n_errors + 1
            wait_s = min(AGAIN_S * 2 ** (n_errors - 1), AGAIN_MOST_S) if n_errors else FLUSH_S
        self._drain()
        self._quietly(self._sink.close)

    def _drain(self) -> bool:
        """Write all that waits; return whether the sink took it."""
        while self._take():
            try:
                with foreign("it"):  # whatever a library or a plug-in raises
                    self._sink.write(self._batch)
            except ForeignError as error:
                self._lose(error.__cause__ or error)
                return False
            self.sent += len(self._batch)
            self._batch = []
            if self.state == "lost":
                self._notes.append(f"sink {self.name} takes records again")
            self.state = "connected"
        return True

    def _take(self) -> bool:
        with self._lock:
            while self._queue and len(self._batch) < BATCH:
                self._batch.append(self._queue.popleft())
        return bool(self._batch)

    def _lose(self, error: BaseException) -> None:
        if self.state != "lost":
            self.lost += 1
            reason = one_line(error) or type(error).__name__
            self._notes.append(f"sink {self.name} takes nothing: {reason}; it is tried again")
        self.state = "lost"
        self._quietly(self._sink.close)

    def _quietly(self, call: Callable[[], None]) -> None:
        try:
            with foreign(f"sink {self.name}"):
                call()
        except ForeignError as error:
            self._notes.append(f"{error} when it is closed")
