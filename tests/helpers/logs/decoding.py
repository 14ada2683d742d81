"""Frames through decoder and assembler, for tests that look at single frames and samples."""

from collections.abc import Sequence

from monitor.base.types import Frame
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.bus_map import BusMap
from monitor.frames.blocks import block_of

Values = dict[str, float] | None  # of a frame by channel, None if it is not used


class Decoding:
    """A decoder, and what it makes of each frame."""

    def __init__(self, bus_map: BusMap, names: Sequence[str]) -> None:
        self.decoder = BlockDecoder(bus_map, names)

    def push(self, frames: Sequence[Frame]) -> list[Values]:
        """Return the values of each of some frames, which are one block."""
        found: list[Values] = [None] * len(frames)
        for part in self.decoder.push(block_of(list(frames))):
            assert sorted(set(part.rows.tolist())) == part.rows.tolist()
            names = [self.decoder.channels[channel] for channel in part.channels]
            for row, values in zip(part.rows.tolist(), part.values.T.tolist(), strict=True):
                found[row] = {**(found[row] or {}), **dict(zip(names, values, strict=True))}
        return found

    def one(self, frame: Frame) -> Values:
        """Return the values of one frame, a block of its own."""
        return self.push([frame])[0]


def values_of(bus_map: BusMap, name: str, frames: Sequence[Frame]) -> list[float]:
    """Return the values of one channel in the frames that are used."""
    found = Decoding(bus_map, [name]).push(frames)
    return [values[name] for values in found if values]
