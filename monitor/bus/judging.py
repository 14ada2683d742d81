"""Frames in, events out, with every change of the fault memory stored before it is told.

The live loop and a listener of python-can judge a bus with it.
"""

import math
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from monitor.base.errors import RecordingError
from monitor.base.types import FrameBlock
from monitor.memory.reference import Seen
from monitor.memory.store import Memory
from monitor.pipeline.collector import Collector
from monitor.pipeline.entry import bus_sources
from monitor.pipeline.events import BlockEvent, CutJudged, CycleStarted, Ticks, WindowJudged
from monitor.pipeline.frames import FramePipeline
from monitor.pipeline.replay import Setup, of_memory, store_of

KEEP: Final = 1_000  # latest windows kept: three hours of driving in 2.5 MB
KEEP_SAMPLES: Final = 200_000  # latest samples kept for the report: 5 h at 10 Hz
STORE_AGAIN_S: Final = 10.0  # wait after a failed attempt to store the fault memory
STORE_DRIVEN_S: Final = 60.0  # most engine running time that a kill may lose


class Judging:
    """One sensor on a bus: pipeline, collected result and fault memory.

    memory : fault memory on disk, None keeps codes in RAM only
    trace : keep the series for a report
    say : receives messages about the fault memory
    monotonic_s : clock for the next attempt to store, in s
    """

    def __init__(
        self,
        setup: Setup,
        memory: Memory | None = None,
        *,
        trace: bool = False,
        say: Callable[[str], None] = print,
        monotonic_s: Callable[[], float] = time.monotonic,
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
        self.memory_errors = 0  # failed attempts to store
        self.store_again_s = math.inf  # time of the next attempt on the clock, inf if none is due
        self._stored_run_s = store.counts.engine_run_since_clear_s

    @property
    def is_failing(self) -> bool:
        """Return whether the latest change is not stored yet."""
        return self.store_again_s < math.inf

    def push(self, block: FrameBlock) -> Iterator[BlockEvent]:
        """Take a block of frames and yield its events; all of them must be taken."""
        for event in self.pipeline.push(block):
            if not isinstance(event, Ticks | WindowJudged | CutJudged) or self._has_driven:
                self.store()
            if isinstance(event, CycleStarted):
                self._learn(event.seen)
                if self._memory:  # the next cycle is judged with the vehicle's latest reference
                    self.pipeline.monitor.adopt(self._setup.of_vehicle(self._memory).limits)
            self.collector.push(event)
            yield event

    @property
    def _has_driven(self) -> bool:
        """Return whether enough running time has passed since the last storing."""
        run_s = self.pipeline.monitor.store.counts.engine_run_since_clear_s
        return run_s - self._stored_run_s >= STORE_DRIVEN_S

    def store(self) -> None:
        """Store the changes of the fault memory; on failure tell it once and try again later."""
        if self._memory is None:
            return
        failing = self.is_failing
        saved = self.pipeline.monitor.store.saved
        self._stored_run_s = saved.counts.engine_run_since_clear_s
        try:
            self._memory.save(saved)
        except RecordingError as error:
            self.memory_errors += 1
            self.store_again_s = self._now_s() + STORE_AGAIN_S
            if not failing:
                self._say(f"{error}; judging goes on, storing is tried again")
            return
        self.store_again_s = math.inf
        if failing:
            self._say("the fault memory is stored again")

    def close(self) -> None:
        """Store the last changes, and the reference that this driving cycle taught."""
        self.store()
        self._learn(self.pipeline.monitor.decisions.seen)
        if self.is_failing:
            self._say("the last changes of the fault memory are lost: they could not be stored")

    def result(self, path: str, counters: Mapping[str, int]) -> dict[str, Any]:
        """Return the run so far as a recording's entry of ``o2mon.replay/1``."""
        entry = self.collector.result(path, None, counters) | of_memory(self._memory)
        return entry | ({"notes": notes} if (notes := list(self.collector.notes)) else {})

    def _learn(self, seen: Seen | None) -> None:
        """Add a driving cycle to the vehicle's reference."""
        if self._memory is None:
            return
        try:
            self._memory.learn(self._setup.model.sha256, seen, self._setup.config.bias)
        except RecordingError as error:
            self._say(str(error))
