"""Blocks of frames to the samples of one recording, with the loop's own frames among them."""

from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from monitor.batch.assemble import BlockAssembler
from monitor.batch.blocks import chosen
from monitor.batch.decode import BlockDecoder
from monitor.decode import EXTENDED
from monitor.own_frames import BUS_STATE_ID, CLEARED_ID
from monitor.types import FrameBlock, SampleBlock

_BUS_STATE, _CLEARED = BUS_STATE_ID | EXTENDED, CLEARED_ID | EXTENDED


class Clearing(NamedTuple):
    """A tester has cleared the codes."""

    n_samples: int  # complete before it
    t_ns: int


class LogSamples(NamedTuple):
    """What frames say on the grid."""

    samples: SampleBlock
    clearings: tuple[Clearing, ...]


def log_samples(
    blocks: Iterable[FrameBlock], decoder: BlockDecoder, assembler: BlockAssembler
) -> LogSamples:
    """Return what ``FramePipeline.samples`` gives of the frames of a log.

    Raises what reading the blocks raises.
    """
    clearings: list[Clearing] = []
    for block in blocks:
        for part in _up_to_own(block):
            assembler.push(part.t_ns, decoder.push(part))
            last = part.key[-1]
            if last == _BUS_STATE:
                assembler.set_off_bus(part.length[-1] == 1 and part.data[-1, 0] == 1)
            elif last == _CLEARED:
                clearings.append(Clearing(assembler.complete, int(part.t_ns[-1])))
    return LogSamples(assembler.finish(), tuple(clearings))


def _up_to_own(block: FrameBlock) -> Iterator[FrameBlock]:
    """Yield a block in parts that end with the own frames that change something."""
    if len(block.key) == 0:
        return
    own = np.flatnonzero(block.key >= _CLEARED)
    own = own[(block.key[own] == _BUS_STATE) | (block.key[own] == _CLEARED)]
    for begin, end in pairwise([0, *(own + 1).tolist(), len(block.key)]):
        if begin < end:
            yield chosen(block, slice(begin, end))
