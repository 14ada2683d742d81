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
from monitor.bus.link.clock import Clock
from monitor.bus.link.port import BusHealth, Port
from monitor.bus.link.recorder import Recorder
from monitor.bus.link.socketcan import BLOCK_S
from monitor.frames.loop_frames import bus_state, codes_cleared, is_own, time_mark
from monitor.memory.reference import Seen
from monitor.memory.store import Memory
from monitor.pipeline.entry import bus_sources
from monitor.pipeline.events import (
    BlockEvent,
    CycleStarted,
    Event,
    Tick,
    Ticks,
    WindowJudged,
    singly,
)
from monitor.pipeline.frames import FramePipeline
from monitor.report.replay import Setup, frame_counters, of_memory, store_of
from monitor.report.sinks import Collector

KEEP: Final = 1_000  # latest windows kept: three hours of driving in 2.5 MB
KEEP_SAMPLES: Final = 200_000  # latest samples kept for the report: 5 h at 10 Hz
_STALE: Final = int(Quality.STALE)
STORE_AGAIN_S: Final = 10.0  # wait after a failed attempt to store the fault memory
STORE_DRIVEN_S: Final = 60.0  # most engine running time that a kill may lose


class Loop:
    """One run of the monitor on a bus.

    reopen : opens the bus again after a loss; without it a loss ends the run
    memory : fault memory; a change is stored before it is announced
    record : log to write
    attachments : attachments of the loop; the list may grow until ``run``
    say : receives messages about the run
    monotonic_s : clock that measures the silence of the bus, in s
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
        monotonic_s: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._memory, self._say, self._now_s = memory, say, monotonic_s
        store = store_of(memory, setup.config.profile)
        self._setup = setup = setup.of_vehicle(memory) if memory else setup
        self.pipeline = FramePipeline(setup.bus_map, setup.model, setup.limits, setup.config, store)
        monitor = self.pipeline.monitor
        self.collector = Collector(
            monitor,
            sources=bus_sources(setup.bus_map, monitor.names),
            trace=trace,
            keep=KEEP,
            keep_samples=KEEP_SAMPLES,
        )
        self.attachments = list(attachments)
        self.health = BusHealth()
        self._port = Port(bus, self.health, reopen, say, monotonic_s, sleep)
        self._record_path = record
        self._recorder: Recorder | None = None
        self.clock = Clock(monotonic_s, min(self.pipeline.decoder.timeouts_ns))
        self._due_s = self._store_again_s = math.inf
        self._stored_run_s = store.counts.engine_run_since_clear_s
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
                self._port.set_filters({*decoder.identifiers, *self._wanted}, decoder.groups)
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
        if self._store_again_s < math.inf:
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
        events = self.pipeline.push(frame)
        if events:
            for event in events:
                self._handle(event)
            self._work()

    def _handle(self, event: BlockEvent) -> None:
        if not isinstance(event, Ticks | WindowJudged) or self._has_driven:
            self._store()
        if isinstance(event, CycleStarted):
            self._learn(event.seen)
            if self._memory is not None:
                self._adopt(self._memory)
        self.collector.push(event)
        for each in singly(event):
            self._tell(each)
            if isinstance(each, Tick):
                self._note_stale(each)

    @property
    def _has_driven(self) -> bool:
        """Return whether enough running time has passed since the last storing."""
        run_s = self.pipeline.monitor.store.counts.engine_run_since_clear_s
        return run_s - self._stored_run_s >= STORE_DRIVEN_S

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
        if now_s >= self._store_again_s:
            self._store()
        for attachment in tuple(self.attachments):
            for frame in self._ask(attachment, attachment.work, now_s):
                self._port.send(frame)
        self._due_s = min((self._due_of(a) for a in tuple(self.attachments)), default=math.inf)
        self._due_s = min(self._due_s, self._store_again_s)

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
        """Store the changes of the fault memory; on failure tell it once and try again later."""
        if self._memory is None:
            return
        failing = self._store_again_s < math.inf
        saved = self.pipeline.monitor.store.saved
        self._stored_run_s = saved.counts.engine_run_since_clear_s
        try:
            self._memory.save(saved)
        except RecordingError as error:
            self.health.memory_errors += 1
            self._store_again_s = self._now_s() + STORE_AGAIN_S
            self._due_s = min(self._due_s, self._store_again_s)
            if not failing:
                self._say(f"{error}; judging goes on, storing is tried again")
            return
        self._store_again_s = math.inf
        if failing:
            self._say("the fault memory is stored again")

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
        if self._memory:
            self._store()
            self._learn(self.pipeline.monitor.seen)

    def _adopt(self, memory: Memory) -> None:
        """Judge the next driving cycle with the latest reference of the vehicle."""
        try:
            self.pipeline.monitor.adopt(self._setup.of_vehicle(memory).limits)
        except RecordingError as error:
            self._say(str(error))

    def _learn(self, seen: Seen | None) -> None:
        """Add a driving cycle to the vehicle's reference."""
        if self._memory is None:
            return
        try:
            self._memory.learn(self._setup.model_sha256, seen, self._setup.config.bias)
        except RecordingError as error:
            self._say(str(error))

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
        return self.collector.result(channel, None, counters) | of_memory(self._memory)


def run(loop: Loop, duration_s: float | None) -> None:
    """Run the loop until its time is over or a signal ends it."""
    with ended_by_signals(loop.stop):
        loop.run(duration_s)
