"""A drive while it is driven: frames one by one."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Final, Self

import can

from monitor.api.recordings import Buses, path_of, set_up
from monitor.api.verdict import Verdict
from monitor.base.types import Frame
from monitor.bus.judging import Judging
from monitor.frames.blocks import block_of
from monitor.frames.logs import frame_of
from monitor.frames.loop_frames import is_own
from monitor.grid.block_assembler import LATEST_NS
from monitor.memory.store import Memory
from monitor.model.step import Model
from monitor.pipeline.events import BlockEvent

MOST: Final = 1 << 12  # frames that gather


class Monitor:
    """Judges one sensor from CAN frames in the order of their time.

    Time comes with the frames; a clock is never asked. A frame that cannot be used is counted.

    model, buses, config, memory : as in ``replay``
    series : keep measurement and prediction in ``Verdict.series``, the latest five hours at 10 Hz
    Raises O2Error with one line that says what cannot be used.

    >>> import can
    >>> with Monitor() as monitor:
    ...     events = monitor.push(can.Message(timestamp=0.0, arbitration_id=0x123, data=b"1"))
    ...     monitor.verdict.is_judged
    False
    """

    def __init__(
        self,
        model: str | Path | Model | None = None,
        *,
        buses: Buses = (),
        config: str | Path | None = None,
        memory: str | Path | None = None,
        series: bool = False,
    ) -> None:
        self.setup = set_up(model, buses, None, config)
        self._memory = held = Memory(path_of(memory), hold=True) if memory else None
        self.notes = [held.condition.says] if held and held.condition.says else []
        with ExitStack() as at_failure:
            if held:
                at_failure.callback(held.close)
            self.judging = Judging(self.setup, held, trace=series, say=self.notes.append)
            at_failure.pop_all()
        self._gathered: list[Frame] = []  # of the open tick
        self.skipped = 0  # error frames, remote frames, and frames of the monitor's own identifiers

    def push(self, message: can.Message | Frame) -> list[BlockEvent]:
        """Take one message and return its events: ticks, windows, changes of codes."""
        frame = self.usable(message)
        if frame is not None and abs(frame.t_ns) >= LATEST_NS:
            self.judging.pipeline.assembler.counters.late += 1
            return []
        return [] if frame is None else list(self.take(frame))

    def usable(self, message: can.Message | Frame) -> Frame | None:
        """Return a message as a frame; None, and counted, if it is none that can be judged."""
        frame: Frame | None = None
        if isinstance(message, Frame):
            frame = message
        elif not (message.is_error_frame or message.is_remote_frame):
            frame = frame_of(message)
        if frame is None or is_own(frame):
            self.skipped += 1
            return None
        return frame

    def take(self, frame: Frame) -> Iterator[BlockEvent]:
        """Return the events of a frame or time mark; all of them must be taken.

        A sample is complete with the first frame behind it, so frames gather until then.
        """
        first_ns, end_ns = self.judging.pipeline.assembler.open_ns
        self._gathered.append(frame)
        if first_ns <= frame.t_ns <= end_ns and len(self._gathered) < MOST:
            return iter(())
        return self._judge()

    def _judge(self) -> Iterator[BlockEvent]:
        block, self._gathered = block_of(self._gathered), []
        return self.judging.push(block)

    @property
    def verdict(self) -> Verdict:
        """Return the verdict so far."""
        for _ in self._judge():
            pass  # within the open tick: there is none
        collector = self.judging.collector
        counters = self.judging.pipeline.counters | {"skipped": self.skipped}
        return Verdict(self.judging.result("bus", counters), collector.trace())

    def close(self) -> None:
        """Store and close the fault memory; the verdict can still be read."""
        memory, self._memory = self._memory, None
        if memory is not None:
            self.judging.close()
            memory.close()

    def __enter__(self) -> Self:
        """Return the monitor."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()
