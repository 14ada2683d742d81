"""Steps 2 to 9 as one object without I/O: frames in, events out, for a live bus."""

from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np

from monitor.base.config import Config
from monitor.base.types import Frame, Sample, SampleBlock
from monitor.decode.bus_map import BusMap
from monitor.frames.loop_frames import CLEARED_ID
from monitor.grid.samples import FrameSamples
from monitor.judge.limits import Limits
from monitor.memory.dtc_store import DtcStore
from monitor.model.step import Model
from monitor.pipeline.events import BlockEvent
from monitor.pipeline.monitor import Judge, Monitor
from monitor.pipeline.names import needed_names


class FramePipeline:
    """Decoder and assembler in front of a monitor."""

    def __init__(
        self, bus_map: BusMap, model: Model, limits: Limits, config: Config, store: DtcStore
    ) -> None:
        card = model.card
        names = needed_names(card, (*bus_map.names, *bus_map.optional))
        self.monitor = Monitor(Judge(names, model, config), limits, store, is_live=True)
        self._samples = FrameSamples(bus_map, names, card.period_ns)
        self.decoder, self.assembler = self._samples.decoder, self._samples.assembler

    def push(self, frame: Frame) -> Iterator[BlockEvent] | Sequence[BlockEvent]:
        """Take one frame and return the events that it causes, for most frames none."""
        samples = self._samples.push(frame)
        events = self.monitor.push(block_of(samples)) if samples else ()
        if frame[1] == CLEARED_ID and frame[2]:
            return chain(events, self._cleared(frame[0]))
        return events

    def _cleared(self, t_ns: int) -> Iterator[BlockEvent]:
        yield from self.monitor.clear(t_ns)


def block_of(samples: Sequence[Sample]) -> SampleBlock:
    """Return samples side by side."""
    if len(samples) == 1:
        index, t_ns, values, quality = samples[0]
        return SampleBlock(np.array([index]), np.array([t_ns]), values[None], quality[None])
    index_, t_ns_, values_, quality_ = zip(*samples, strict=True)
    return SampleBlock(
        np.array(index_), np.array(t_ns_), np.array(values_), np.array(quality_, dtype=np.uint8)
    )
