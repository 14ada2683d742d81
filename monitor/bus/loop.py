"""The real-time loop: one thread receives, judges and reports, another writes the log.

On a silent bus the loop makes time marks, which are frames that only move time on; see ``clock``.
Everything beside the judging is an ``Attachment``.
"""

import math
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from types import FrameType
from typing import Any, Final

import can
import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.types import Frame, FrameBlock, Quality
from monitor.bus.attachment import Attachment
from monitor.bus.ending import ended_by_signals
from monitor.bus.judging import Judging
from monitor.bus.link.clock import Clock
from monitor.bus.link.port import ANSWER_S, BusHealth, Port
from monitor.bus.link.recorder import LiveRecorder
from monitor.bus.link.suspension import Suspension, passed_s, slept_s
from monitor.frames.blocks import EXTENDED, block_of, chosen, frames_of
from monitor.frames.loop_frames import bus_state, codes_cleared, log_gap, time_mark
from monitor.memory.store import Memory
from monitor.pipeline.events import Event, Tick, singly
from monitor.pipeline.replay import Setup

BLOCK_S: Final = 0.1  # longest wait for a frame, so that a stop request is noticed
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
        self.health = BusHealth(absent=setup.bus_map.optional)
        self._port = Port(
            bus=bus,
            health=self.health,
            reopen=reopen,
            say=say,
            monotonic_s=monotonic_s,
            sleep=sleep,
        )
        self._record_path = record
        self._recorder: LiveRecorder | None = None
        self.clock = Clock(monotonic_s, min(self.pipeline.decoder.timeouts_ns))
        self._suspension = Suspension(slept_s)
        self._due_s = math.inf
        self._wanted: dict[int, list[Attachment]] = {}  # by the keys of their frames
        self._stop = self._is_off = self._has_begun = False

    def stop(self, *_: int | FrameType | None) -> None:
        """End the loop after the current frames; a signal handler may call it."""
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
                groups = (*decoder.groups, *self.pipeline.answers.groups)
                self._port.set_filters({*decoder.identifiers, *own}, groups)
            else:
                self._recorder = LiveRecorder(self._record_path)
            self._work()
            now_s = self._now_s()
            while not self._stop and now_s < until_s:
                self._listen(now_s)
                now_s = self._now_s()
                if now_s >= self._due_s:
                    self._work()

    def _listen(self, now_s: float) -> None:
        """Wait for frames until something is due, and judge them."""
        longest_s = ANSWER_S if self._wanted else BLOCK_S
        wait_s = min(longest_s, max(self._due_s - now_s, 0.0))
        tick_end_ns = self.pipeline.assembler.open_ns[1] + self.clock.shift_ns
        block = self._port.receive(wait_s, tick_end_ns)
        now_s = self._now_s()
        if self._suspension.has_ended():
            self._make(log_gap(self.clock.slept()))
        if self._is_off and not self._port.is_off:
            self._is_off = False
            self._make(bus_state(self.clock.made(), off=False))
        if len(block.key):
            self._take(self.clock.believed(block, now_s))
        if self._port.is_off and not self._is_off:
            self._is_off = True
            self._make(bus_state(self.clock.made(), off=True))
        mark = self.clock.mark() if self._is_off or not len(block.key) else None
        if mark is not None:
            self._make(mark)

    def clear_codes(self) -> None:
        """Clear the codes, store the change, then report it to the attachments.

        Raises RecordingError if the change could not be stored; the loop tries that again later.
        """
        self._make(codes_cleared(self.clock.made()))
        self._store()
        if self.judging.is_failing:
            raise RecordingError("the codes are cleared, but that is not stored yet")

    def _take(self, block: FrameBlock) -> None:
        """Give the attachments the frames that they want, and judge all."""
        rows = np.flatnonzero(np.isin(block.key, self._keys))
        for row, frame in zip(rows.tolist(), frames_of(chosen(block, rows)), strict=True):
            for attachment in self._wanted.get(int(block.key[row]), ()):
                self._ask(attachment, attachment.receive, frame)
            self._due_s = -math.inf
        self._judge(block)

    def _make(self, frame: Frame) -> None:
        """Judge a frame that the loop makes itself."""
        self._judge(block_of([frame]))

    def _judge(self, block: FrameBlock) -> None:
        if self._recorder is not None:
            if not self._has_begun:  # by a mark a replay knows that the monitor listened live
                self._has_begun = True
                self._make(time_mark(int(block.t_ns[0])))
            self._record(self._recorder, block)
        for event in self.judging.push(block):
            self._due_s = -math.inf
            self.health.memory_errors = self.judging.memory_errors
            for each in singly(event):
                self._tell(each)
                if isinstance(each, Tick):
                    self._note_stale(each)

    def _tell(self, event: Event) -> None:
        for attachment in tuple(self.attachments):
            self._ask(attachment, attachment.push, event)

    def _note_stale(self, tick: Tick) -> None:
        quality = tick.sample.quality.tobytes()  # numpy's comparison takes four times as long
        names, health = self.pipeline.monitor.names, self.health
        if health.absent:
            good = {n for n, kind in zip(names, quality, strict=True) if kind == Quality.GOOD}
            health.absent = tuple(n for n in health.absent if n not in good)
        pairs = zip(names, quality, strict=True) if _STALE in quality else ()
        stale = [name for name, kind in pairs if kind == _STALE]
        health.stale = tuple(n for n in stale if n not in health.absent)
        health.stale_samples += bool(health.stale)

    def _work(self) -> None:
        """Send the frames of the attachments, and find the time of the next call."""
        now_s, self._due_s = self._now_s(), math.inf
        if now_s >= self.judging.store_again_s:
            self._store()
        for attachment in tuple(self.attachments):
            for frame in self._ask(attachment, attachment.work, now_s):
                self._port.send(frame)
        due_s = (self._due_of(attachment) for attachment in tuple(self.attachments))
        # what an attachment's work has brought about is the others' work at once
        self._due_s = min(self._due_s, self.judging.store_again_s, *due_s)

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
        self._let_go(attachment)

    def _let_go(self, attachment: Attachment) -> None:
        try:
            attachment.close()
        except Exception as error:
            self._say(f"{type(attachment).__name__} did not close: {error}")

    def _rewire(self) -> None:
        self._wanted = {}
        for attachment in self.attachments:
            for can_id, is_extended in attachment.identifiers:
                key = can_id | is_extended * EXTENDED
                self._wanted.setdefault(key, []).append(attachment)
        self._keys = np.array(list(self._wanted), dtype=np.uint32)
        self._due_s = -math.inf

    def _record(self, recorder: LiveRecorder, block: FrameBlock) -> None:
        try:
            recorder.write(block)
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
        self.judging.close()  # stored before an attachment may hang
        try:
            if self._recorder:
                self._recorder.close()
        except RecordingError as error:
            self._say(str(error))
        for attachment in self.attachments:
            self._let_go(attachment)
        self._port.close()

    def result(self, channel: str) -> dict[str, Any]:
        """Return the run as a recording's entry of ``o2mon.replay/1``."""
        counters = self.pipeline.counters | self.clock.counters.found
        counters["skipped"] = self.health.error_frames + self.health.remote_frames
        counters["transmit_errors"] = self.health.transmit_errors
        return self.judging.result(channel, counters)


def run(loop: Loop, duration_s: float | None) -> None:
    """Run the loop until its time is over or a signal ends it."""
    with ended_by_signals(loop.stop):
        loop.run(duration_s)
