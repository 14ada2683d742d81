"""Steps 2 to 9 as one object without I/O: blocks of frames in, events out, for a live bus."""

from collections.abc import Iterator

from monitor.base.config import Config
from monitor.base.types import FrameBlock
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.bus_map import BusMap
from monitor.decode.log_blocks import EngineAnswers
from monitor.grid.block_assembler import BlockAssembler
from monitor.grid.block_samples import Clearing, FrameSamples
from monitor.judge.limits import Limits
from monitor.memory.dtc_store import DtcStore
from monitor.model.step import Model
from monitor.pipeline.entry import frame_counts
from monitor.pipeline.events import BlockEvent
from monitor.pipeline.monitor import Judge, SensorMonitor
from monitor.pipeline.names import needed_names


class FramePipeline:
    """Decoder and assembler in front of a monitor."""

    def __init__(
        self, bus_map: BusMap, model: Model, limits: Limits, config: Config, store: DtcStore
    ) -> None:
        card = model.card
        names = needed_names(card, (*bus_map.names, *bus_map.optional))
        self.monitor = SensorMonitor(Judge(names, model, config), limits, store, is_live=True)
        self.decoder = BlockDecoder(bus_map, names)
        self.assembler = BlockAssembler.of(self.decoder, card.period_ns)
        self.answers = EngineAnswers(self.decoder.plans)
        self._samples = FrameSamples(self.decoder, self.assembler, is_live=True)

    def push(self, block: FrameBlock) -> Iterator[BlockEvent]:
        """Take a block of frames and yield its events; all of them must be taken."""
        for part in self._samples.push(self.answers.push(block)):
            if isinstance(part, Clearing):
                yield from self.monitor.clear(part.t_ns)
            elif len(part.t_ns):
                yield from self.monitor.push(part)

    @property
    def counters(self) -> dict[str, int]:
        """Return the number of frames that could not be used, by reason."""
        self._samples.flush()  # within the open tick: no sample is complete
        return frame_counts(self.decoder.counters, self.assembler.counters, self.decoder.unmapped)
