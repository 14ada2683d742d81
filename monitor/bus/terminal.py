"""The terminal of ``o2mon run``: a status line or plain lines."""

import math
import os
import shutil
import stat
from collections import deque
from typing import Final, TextIO

from monitor.base.types import Frame
from monitor.bus.attachment import Attachment
from monitor.bus.link.port import BusHealth
from monitor.judge.enable import TABLE
from monitor.pipeline.collector import Collector
from monitor.pipeline.events import Event, Tick, WindowJudged
from monitor.pipeline.monitor import SensorMonitor
from monitor.report.lines import event_line

REDRAW_S: Final = 0.25
WAITING_LINES: Final = 1000  # kept for a reader that hangs
_ERASE: Final = "\r\x1b[K"
_STATE_WIDTH: Final = len("waits until ") + max(len(each.words) for each in TABLE)


class Out:
    """Prints lines, and never waits for a reader that hangs: lines that it does not take are lost.

    A terminal or pipe is written through a file of its own that does not block; the stream's own
    is shared with the shell.
    """

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream
        self._number = _not_blocking(stream)
        self.waiting = deque[str](maxlen=WAITING_LINES)
        self._rest = b""  # of what was begun
        self._drawn = ""

    def say(self, line: str) -> None:
        """Print a line, above the one that is drawn."""
        self.waiting.append(line)
        self.flush()

    def draw(self, line: str) -> None:
        """Put a line in the place of the one drawn before."""
        if line != self._drawn and self._is_free():
            self._write(_ERASE + line)
            self._drawn = line

    def flush(self) -> None:
        """Print the waiting lines, as far as the reader takes them."""
        while self.waiting and self._is_free():
            line = self.waiting.popleft()
            self._write(f"{_ERASE}{line}\n{self._drawn}" if self._drawn else f"{line}\n")

    def close(self) -> None:
        """Leave a clean line behind; what others say at their end may still follow."""
        if self._drawn and self._is_free():
            self._write(_ERASE)
        self._drawn = ""
        self.flush()

    def _is_free(self) -> bool:
        """Return whether all that was written was taken."""
        if self._rest:
            self._write("")
        return not self._rest

    def _write(self, text: str) -> None:
        try:
            if self._number is None:
                self.stream.write(text)
                self.stream.flush()
                return
            self._rest += text.encode()
            self._rest = self._rest[os.write(self._number, self._rest) :]
        except BlockingIOError:
            pass
        except OSError:  # nobody reads any more; the verdict still counts
            self._rest = b""


def _not_blocking(stream: TextIO) -> int | None:
    """Return a file of its own onto a terminal or pipe, None where there is no need or way."""
    try:
        mode = os.fstat(stream.fileno()).st_mode
        if not (stat.S_ISFIFO(mode) or stream.isatty()):
            return None
        path = f"/proc/self/fd/{stream.fileno()}"
        return os.open(path, os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    except (OSError, ValueError, AttributeError):  # Windows has neither the path nor the flags
        return None


class StatusLine(Attachment):
    """The loop's state in one line: an attachment that only listens."""

    def __init__(self, monitor: SensorMonitor, health: BusHealth) -> None:
        self._monitor, self._health = monitor, health
        self._output = monitor.names.index(monitor.output)
        self._tick: Tick | None = None
        self._windows = self._failed = 0

    def push(self, event: Event) -> None:
        """Note the latest sample and count the windows."""
        if isinstance(event, Tick):
            self._tick = event
        elif isinstance(event, WindowJudged):
            self._windows += 1
            self._failed += event.outcome == "failed"

    def line(self) -> str:
        """Return the monitor's state in one line; its parts keep their places."""
        windows = f"windows {self._windows}" + (f", {self._failed} failed" * (self._failed > 0))
        return "  ".join((self._signals(), self._codes(), self._state(), windows, self._bus()))

    def _signals(self) -> str:
        tick = self._tick
        if tick is None:
            return "nothing received yet"
        measured = float(tick.sample.values[self._output])
        name = self._monitor.output.removesuffix("_measured")
        return f"{name} {measured:6.3f} model {tick.predicted:6.3f}"

    def _state(self) -> str:
        held = self._tick.conditions if self._tick else ()
        state = f"waits until {TABLE[held.index(False)].words}" if False in held else "enabled"
        return f"{state if held else '':<{_STATE_WIDTH}}"

    def _codes(self) -> str:
        active = self._monitor.store.active
        return ", ".join(f"{d.code} {d.state}" for d in active) or "no code"

    def _bus(self) -> str:
        health = self._health
        bad = {
            "errors": health.error_frames,
            "lost": (health.drops or 0) + health.overruns,
            "malformed": health.malformed,
            "stale": len(health.stale),
            "reconnects": health.reconnects,
            "not stored": health.memory_errors,
            "off": health.detached,
        }
        counted = "".join(f" {name} {n}" for name, n in bad.items() if n)
        return f"bus {health.state}{counted}  {health.frames} frames"


class EventLines(StatusLine):
    """One line for every window and every changed code, for the journal of a service."""

    def __init__(
        self, monitor: SensorMonitor, health: BusHealth, collector: Collector, out: Out
    ) -> None:
        super().__init__(monitor, health)
        self._collector, self._out = collector, out

    def push(self, event: Event) -> None:
        """Print an event that is no tick."""
        super().push(event)
        if not isinstance(event, Tick):
            self._out.say(event_line(event, self._collector))

    def work(self, now_s: float) -> tuple[Frame, ...]:
        """Print the lines that a slow reader did not take before."""
        self._out.flush()
        return ()

    def close(self) -> None:
        """Print the remaining lines."""
        self._out.close()


class Screen(EventLines):
    """The lines, and under them the state, drawn anew four times a second at most."""

    due_s = -math.inf

    def work(self, now_s: float) -> tuple[Frame, ...]:
        """Draw the state if it is time."""
        if now_s >= self.due_s:
            self.due_s = now_s + REDRAW_S
            self._out.flush()
            columns = shutil.get_terminal_size().columns
            self._out.draw(self.line()[: max(columns - 1, 20)])
        return ()
