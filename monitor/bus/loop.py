"""The real-time loop: one thread receives, judges, records and reports.

On a silent bus the loop makes time marks, which are frames that only move time on; see ``clock``.
Everything beside the judging is an ``Attachment``.
"""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from types import FrameType
from typing import Any, Final

import can

from monitor.base.errors import RecordingError
from monitor.base.types import Frame, Quality
from monitor.bus.attachment import Attachment
from monitor.bus.ending import ended_by_signals
from monitor.bus.judging import Judging
from monitor.bus.link.clock import Clock
from monitor.bus.link.port import BusHealth, Port
from monitor.bus.link.recorder import Recorder
from monitor.bus.link.socketcan import BLOCK_S
from monitor.bus.link.suspension import Suspension, passed_s, slept_s
from monitor.frames.loop_frames import bus_state, codes_cleared, is_own, log_gap, time_mark
from monitor.memory.store import Memory
from monitor.pipeline.events import (
    Event,
    Tick,
    singly,
)
from monitor.pipeline.replay import Setup, frame_counters

_STALE: Final = int(Quality.STALE)


class Loop:
    """One run of the monitor on a bus.

    reopen : opens the bus again after a loss; without it a loss ends the run
    memory : fault memory; a change is stored before it is announced
    record : log to write
    attachments : attachments of the loop; the list may grow until ``run``
    say : receives messages about the run
    monotonic_s : clock that measures the silence of the bus, in s; it goes on while the machine
        is suspended
    slept_s : for how many s the machine has been suspended in all
    sleep : waits while the bus is lost
    """

    def __init__(
        self,
        bus: can.BusABC,
        setup: Setup,
        *,
        reopen: Callable[[], can.BusABC] | None = None,
        memory: Memory | None = None,
        record: Path | None = None,
        attachments: Sequence[Attachment] = (),
        trace: bool = False,
        say: Callable[[str], None] = print,
        monotonic_s: Callable[[], float] = passed_s,
        sleep: Callable[[float], None] = time.sleep,
        slept_s: Callable[[], float] = slept_s,
    ) -> None:
        self._say, self._now_s = say, monotonic_s
        self.judging = Judging(setup, memory, trace=trace, say=say, monotonic_s=monotonic_s)
        self.pipeline, self.collector = self.judging.pipeline, self.judging.collector
        self.attachments = list(attachments)
        self.health = BusHealth()
        self._port = Port(
            bus=bus,
            health=self.health,
            reopen=reopen,
            say=say,
            monotonic_s=monotonic_s,
            sleep=sleep,
        )
        self._record_path = record
        self._recorder: Recorder | None = None
        self.clock = Clock(monotonic_s, min(self.pipeline.decoder.timeouts_ns))
        self._suspension = Suspension(slept_s)
        self._due_s = math.inf
        self._wanted: dict[tuple[int, bool], list[Attachment]] = {}
        self._stop = self._is_off = self._has_begun = False

    def stop(self, *_: int | FrameType | None) -> None:
        """End the loop after the current frame; a signal handler may call it."""
        self._stop = True

    def run(self, duration_s: float | None = None) -> None:
        """Receive and judge until stopped, or for ``duration_s``.

        Raises BusError if the interface fails and cannot be opened again.
        """
        until_s = math.inf if duration_s is None else self._now_s() + duration_s
        self._rewire()
        with ExitStack() as stack:
            stack.callback(self._close)
            if self._record_path is None:
                decoder = self.pipeline.decoder
                own = (i for attachment in self.attachments for i in attachment.identifiers)
                self._port.set_filters({*decoder.identifiers, *own}, decoder.groups)
            else:
                self._recorder = Recorder(self._record_path)
            receive, clock = self._port.receive, self.clock
            assembler = self.pipeline.assembler
            now_s = self._now_s()
            while not self._stop and now_s < until_s:
                if now_s >= self._due_s:
                    self._work()
                wait_s = min(BLOCK_S, max(self._due_s - now_s, 0.0))
                frame = receive(wait_s, assembler.tick_end_ns + clock.shift_ns)
                now_s = self._now_s()
                if self._suspension.has_ended(now_s):
                    self._judge(log_gap(self.clock.slept()))
                if frame is None or self._is_off:
                    for made in self._loop_frames():
                        self._judge(made)
                if frame is not None:
                    if is_own(frame):
                        self.health.refused += 1
                    elif clock.heard(frame[0], now_s):
                        self._take(frame)
                    else:
                        for timed in clock.weighed(frame, now_s):
                            self._take(timed)

    def _loop_frames(self) -> Iterator[Frame]:
        """Yield the loop's frames that are due: bus state and time mark."""
        if self._port.is_off != self._is_off:
            self._is_off = self._port.is_off
            yield bus_state(self.clock.made(), off=self._is_off)
        mark = self.clock.mark()
        if mark is not None:
            yield mark

    def clear_codes(self) -> None:
        """Clear the codes, store the change, then report it to the attachments.

        Raises RecordingError if the change could not be stored; the loop tries that again later.
        """
        self._judge(codes_cleared(self.clock.made()))
        self._store()
        if self.judging.is_failing:
            raise RecordingError("the codes are cleared, but that is not stored yet")

    def _take(self, frame: Frame) -> None:
        self._judge(frame)
        wanted = self._wanted.get((frame.can_id, frame.is_extended))
        if wanted:
            for attachment in wanted:
                for made in self._ask(attachment, attachment.receive, frame):
                    self._judge(made)
            self._work()

    def _judge(self, frame: Frame) -> None:
        if self._recorder is not None:
            if not self._has_begun:  # by a mark a replay knows that the monitor listened live
                self._has_begun = True
                self._judge(time_mark(frame.t_ns))
            self._record(self._recorder, frame)
        has_events = False
        for event in self.judging.push(frame):
            has_events = True
            self.health.memory_errors = self.judging.memory_errors
            for each in singly(event):
                self._tell(each)
                if isinstance(each, Tick):
                    self._note_stale(each)
        if has_events:
            self._work()

    def _tell(self, event: Event) -> None:
        for attachment in tuple(self.attachments):
            self._ask(attachment, attachment.push, event)

    def _note_stale(self, tick: Tick) -> None:
        quality = tick.sample.quality.tobytes()  # numpy's comparison takes four times as long
        if _STALE not in quality:
            self.health.stale = ()
            return
        names = self.pipeline.monitor.names
        pairs = zip(names, quality, strict=True)
        self.health.stale = tuple(name for name, kind in pairs if kind == _STALE)
        self.health.stale_samples += 1

    def _work(self) -> None:
        """Send the frames of the attachments, and find the time of the next call."""
        now_s = self._now_s()
        if now_s >= self.judging.store_again_s:
            self._store()
        for attachment in tuple(self.attachments):
            for frame in self._ask(attachment, attachment.work, now_s):
                self._port.send(frame)
        self._due_s = min((self._due_of(a) for a in tuple(self.attachments)), default=math.inf)
        self._due_s = min(self._due_s, self.judging.store_again_s)

    def _due_of(self, attachment: Attachment) -> float:
        try:
            return attachment.due_s
        except Exception as error:
            self._detach(attachment, error)
            return math.inf

    def _ask(
        self, attachment: Attachment, call: Callable[[Any], Iterable[Frame] | None], about: Any
    ) -> list[Frame]:
        """Return the frames that an attachment answers; detach it if it raises."""
        try:
            return list(call(about) or ())
        except Exception as error:  # a failing attachment must not end the judging
            self._detach(attachment, error)
            return []

    def _detach(self, attachment: Attachment, error: Exception) -> None:
        if attachment not in self.attachments:
            return
        self.attachments.remove(attachment)
        self._rewire()
        self.health.detached += 1
        name, kind = type(attachment).__name__, type(error).__name__
        self._say(f"{name} failed and is switched off: {kind}: {error}")
        try:
            attachment.close()
        except Exception as again:
            self._say(f"{name} did not close: {again}")

    def _rewire(self) -> None:
        self._wanted = {}
        for attachment in self.attachments:
            for identifier in attachment.identifiers:
                self._wanted.setdefault(identifier, []).append(attachment)
        self._due_s = -math.inf

    def _record(self, recorder: Recorder, frame: Frame) -> None:
        try:
            recorder.write(frame)
        except RecordingError as error:
            self._recorder = None  # a log with a gap would not replay to the same events
            self._say(f"{error}; the log ends here, judging goes on")
            with suppress(RecordingError):
                recorder.close()

    def _store(self) -> None:
        self.judging.store()
        self.health.memory_errors = self.judging.memory_errors
        self._due_s = min(self._due_s, self.judging.store_again_s)

    def _close(self) -> None:
        for attachment in tuple(self.attachments):
            try:
                attachment.close()
            except Exception as error:
                self._say(f"{type(attachment).__name__} did not close: {error}")
        try:
            if self._recorder:
                self._recorder.close()
        except RecordingError as error:
            self._say(str(error))
        self._port.close()
        self.judging.close()

    def result(self, channel: str) -> dict[str, Any]:
        """Return the run as a recording's entry of ``o2mon.replay/1``."""
        found = self.clock.counters.found
        counters = (
            frame_counters(self.pipeline)
            | found
            | {
                "skipped": self.health.error_frames + self.health.remote_frames,
                "transmit_errors": self.health.transmit_errors,
            }
        )
        return self.judging.result(channel, counters)


def run(loop: Loop, duration_s: float | None) -> None:
    """Run the loop until its time is over or a signal ends it."""
    with ended_by_signals(loop.stop):
        loop.run(duration_s)
