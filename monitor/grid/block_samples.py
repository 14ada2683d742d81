"""Blocks of frames to the samples of one recording, with the loop's own frames among them."""

from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from monitor.base.types import FrameBlock, IntArray, SampleBlock
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.decoder import EXTENDED
from monitor.frames.blocks import chosen, joined
from monitor.frames.loop_frames import BUS_STATE_ID, CLEARED_ID
from monitor.grid.block_assembler import BlockAssembler

_FRAMES = 1 << 20  # decoded at once
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
    held = _Held(decoder, assembler)
    for block in blocks:
        for part in _up_to_own(block):
            held.push(part)
            last = part.key[-1]
            if last in (_BUS_STATE, _CLEARED):
                held.flush()
            if last == _BUS_STATE:
                assembler.set_off_bus(part.length[-1] == 1 and part.data[-1, 0] == 1)
            elif last == _CLEARED:
                clearings.append(Clearing(assembler.complete, int(part.t_ns[-1])))
    held.flush()
    return LogSamples(assembler.finish(), tuple(clearings))


class _Held:
    """Frames on their way to decoder and assembler: of those nobody needs only the times.

    A message's frames cost the less the more of them are decoded at once.
    """

    def __init__(self, decoder: BlockDecoder, assembler: BlockAssembler) -> None:
        self._decoder, self._assembler = decoder, assembler
        self._clear()

    def _clear(self) -> None:
        self._t_ns: list[IntArray] = []
        self._rows: list[IntArray] = []
        self._needed: list[FrameBlock] = []
        self._n = 0

    def push(self, block: FrameBlock) -> None:
        """Take some frames."""
        rows = self._decoder.needed(block)
        self._t_ns.append(block.t_ns)
        self._rows.append(rows + self._n)
        self._needed.append(chosen(block, rows))
        self._n += len(block.t_ns)
        if self._n >= _FRAMES:
            self.flush()

    def flush(self) -> None:
        """Pass the frames on."""
        if not self._n:
            return
        rows = np.concatenate(self._rows)
        self._decoder.unmapped += self._n - len(rows)
        decoded = [
            part._replace(rows=rows[part.rows]) for part in self._decoder.push(joined(self._needed))
        ]
        self._assembler.push(np.concatenate(self._t_ns), decoded)
        self._clear()


def _up_to_own(block: FrameBlock) -> Iterator[FrameBlock]:
    """Yield a block in parts that end with the own frames that change something."""
    if len(block.key) == 0:
        return
    own = np.flatnonzero(block.key >= _CLEARED)
    own = own[(block.key[own] == _BUS_STATE) | (block.key[own] == _CLEARED)]
    for begin, end in pairwise([0, *(own + 1).tolist(), len(block.key)]):
        if begin < end:
            yield chosen(block, slice(begin, end))
