"""Frames in, samples out: decoder and assembler as one."""

from collections.abc import Sequence

from monitor.base.types import Frame, Sample
from monitor.decode.bus_map import BusMap
from monitor.decode.decoder import Decoder
from monitor.frames.loop_frames import BUS_STATE_ID, LOG_GAP_ID, says_off
from monitor.grid.assembler import Assembler


class FrameSamples:
    """The samples of one bus, frame by frame.

    bus_map : what the bus provides
    names : what a sample holds, any subset of ``bus_map.names``
    period_ns : grid period
    """

    def __init__(self, bus_map: BusMap, names: Sequence[str], period_ns: int) -> None:
        self.decoder = Decoder(bus_map, names)
        self.assembler = Assembler.of(self.decoder, period_ns)

    def push(self, frame: Frame) -> Sequence[Sample]:
        """Take one frame and return the samples that are complete before it."""
        if frame[1] == LOG_GAP_ID and frame[2]:
            return self.assembler.gap(frame[0])
        samples = self.assembler.advance(frame[0])
        if samples is None:  # too late: counted, but not used
            samples, is_used = (), self.decoder.push(frame) is not None
        else:
            is_used = self.decoder.receive(frame)
        if not is_used and frame[1] == BUS_STATE_ID and frame[2]:
            self.assembler.is_off_bus = says_off(frame)
        return samples
