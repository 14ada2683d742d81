"""Blocks of frames to blocks of samples, with the loop's own frames among them.

A message's frames cost the less the more of them are decoded at once, so frames are held: those of
a log until they are many, those of a live bus until the open tick is over.
"""

from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from monitor.base.types import FrameBlock, IntArray, SampleBlock
from monitor.decode.block_decoder import BlockDecoder
from monitor.frames.blocks import EXTENDED, chosen
from monitor.frames.blocks import joined as joined_frames
from monitor.frames.loop_frames import BUS_STATE_ID, CLEARED_ID, LOG_GAP_ID
from monitor.grid.block_assembler import BlockAssembler

_FRAMES = 1 << 18  # decoded at once
_SAMPLES = 1 << 16  # that the time of the frames held may span
_NONE = np.empty(0, dtype=np.int64)
_BUS_STATE, _CLEARED, _GAP = (
    can_id | EXTENDED for can_id in (BUS_STATE_ID, CLEARED_ID, LOG_GAP_ID)
)


class Clearing(NamedTuple):
    """A tester has cleared the codes."""

    n_samples: int  # complete before it
    t_ns: int


class FrameSamples:
    """The samples of a bus from its frames; of those nobody needs only the times are held.

    is_live : samples are given as soon as they are complete
    """

    def __init__(
        self, decoder: BlockDecoder, assembler: BlockAssembler, *, is_live: bool = False
    ) -> None:
        self._decoder, self._assembler, self._is_live = decoder, assembler, is_live
        self._n_samples = 0
        self._clear()

    def push(self, block: FrameBlock) -> Iterator[SampleBlock | Clearing]:
        """Take some frames; yield the samples that are complete, with the clearings between them.

        All of them must be taken.
        """
        assembler = self._assembler
        assembler.is_live |= bool((block.key >= _CLEARED).any())
        for part in _parts(block, _SAMPLES * assembler.period_ns):
            last = part.key[-1]
            if self._n and part.t_ns[-1] - self._t_ns[0][0] > _SAMPLES * assembler.period_ns:
                yield self.flush()
            self._hold(part)
            changes = last in (_BUS_STATE, _CLEARED)
            if not changes and self._n < _FRAMES and not (self._is_live and self._is_due(part)):
                continue
            yield self.flush()
            if last == _BUS_STATE:
                assembler.is_off_bus = bool(part.length[-1] == 1 and part.data[-1, 0] == 1)
            elif last == _CLEARED:
                yield Clearing(self._n_samples, int(part.t_ns[-1]))

    def flush(self) -> SampleBlock:
        """Pass the held frames on; return the samples that are complete."""
        if not self._n:
            return self._assembler.push(_NONE)
        rows, gaps = np.concatenate(self._rows), np.concatenate(self._gaps).tolist()
        self._decoder.unmapped += self._n - len(rows) - len(gaps)
        needed = joined_frames(self._needed)
        decoded = [part._replace(rows=rows[part.rows]) for part in self._decoder.push(needed)]
        t_ns = np.concatenate(self._t_ns)
        self._clear()
        samples = self._assembler.push(t_ns, decoded, gaps)
        self._n_samples += len(samples.t_ns)
        return samples

    def _clear(self) -> None:
        self._t_ns: list[IntArray] = []
        self._rows: list[IntArray] = []
        self._needed: list[FrameBlock] = []
        self._gaps: list[IntArray] = []
        self._n = 0

    def _hold(self, block: FrameBlock) -> None:
        rows = self._decoder.needed(block)
        self._t_ns.append(block.t_ns)
        self._rows.append(rows + self._n)
        self._needed.append(chosen(block, rows))
        self._gaps.append(np.flatnonzero(block.key == _GAP) + self._n)
        self._n += len(block.t_ns)

    def _is_due(self, block: FrameBlock) -> bool:
        """Return whether a block closes the open tick, or breaks with it."""
        first_ns, end_ns = self._assembler.open_ns
        return bool(block.t_ns.max() > end_ns or block.t_ns.min() < first_ns) or bool(
            len(self._gaps[-1])
        )


def log_samples(
    blocks: Iterable[FrameBlock], decoder: BlockDecoder, assembler: BlockAssembler
) -> Iterator[SampleBlock | Clearing]:
    """Yield the samples of a log's frames, block by block, with the clearings between them.

    Raises as the reading of the blocks.
    """
    samples = FrameSamples(decoder, assembler)
    for block in blocks:
        yield from samples.push(block)
    yield samples.flush()


def _parts(block: FrameBlock, longest_ns: int) -> Iterator[FrameBlock]:
    """Yield a block in parts that end with the own frames that change something.

    longest_ns : most time between a part's first frame and those after it, so that few frames far
        apart do not become very many samples at once
    """
    n = len(block.key)
    if n == 0:
        return
    own = np.flatnonzero(block.key >= _CLEARED)
    own = own[(block.key[own] == _BUS_STATE) | (block.key[own] == _CLEARED)]
    edges = {0, *(own + 1).tolist(), n}
    newest_ns = np.maximum.accumulate(block.t_ns)
    if newest_ns[-1] - newest_ns[0] > longest_ns:
        span = (newest_ns - newest_ns[0]) // longest_ns
        edges |= set((np.flatnonzero(np.diff(span)) + 1).tolist())
    for begin, end in pairwise(sorted(edges)):
        yield chosen(block, slice(begin, end))
