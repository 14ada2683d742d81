"""Blocks of frames to blocks of samples, with the loop's own frames among them."""

from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from monitor.base.types import FrameBlock, IntArray, SampleBlock
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.decoder import EXTENDED
from monitor.frames.blocks import chosen
from monitor.frames.blocks import joined as joined_frames
from monitor.frames.loop_frames import BUS_STATE_ID, CLEARED_ID, LOG_GAP_ID
from monitor.grid.block_assembler import BlockAssembler, joined

_FRAMES = 1 << 20  # decoded at once
_SAMPLES = 1 << 18  # that the time of the frames held may span
_NONE = np.empty(0, dtype=np.int64)
_BUS_STATE, _CLEARED, _GAP = (
    can_id | EXTENDED for can_id in (BUS_STATE_ID, CLEARED_ID, LOG_GAP_ID)
)


class Clearing(NamedTuple):
    """A tester has cleared the codes."""

    n_samples: int  # complete before it
    t_ns: int


def log_samples(
    blocks: Iterable[FrameBlock], decoder: BlockDecoder, assembler: BlockAssembler
) -> Iterator[SampleBlock | Clearing]:
    """Yield the samples of a log's frames, block by block, with the clearings between them.

    Raises as the reading of the blocks.
    """
    held = _Held(decoder, assembler)
    n = 0
    for block in blocks:
        assembler.is_live |= bool((block.key >= _CLEARED).any())
        for part in _parts(block, _SAMPLES * assembler.period_ns):
            last = part.key[-1]
            if held.spans(part) > _SAMPLES * assembler.period_ns:
                samples = held.flush()
                n += len(samples.t_ns)
                yield samples
            held.push(part)
            if last not in (_BUS_STATE, _CLEARED) and held.n < _FRAMES:
                continue
            samples = held.flush()
            n += len(samples.t_ns)
            yield samples
            if last == _BUS_STATE:
                assembler.is_off_bus = bool(part.length[-1] == 1 and part.data[-1, 0] == 1)
            elif last == _CLEARED:
                yield Clearing(n, int(part.t_ns[-1]))
    yield held.flush()


def whole(
    parts: Iterable[SampleBlock | Clearing], n_names: int
) -> tuple[SampleBlock, tuple[Clearing, ...]]:
    """Return a recording's samples as one block, and its clearings."""
    blocks: list[SampleBlock] = []
    clearings: list[Clearing] = []
    for part in parts:
        if isinstance(part, Clearing):
            clearings.append(part)
        else:
            blocks.append(part)
    return joined(blocks, n_names), tuple(clearings)


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
        self._gaps: list[IntArray] = []
        self.n = 0

    def spans(self, block: FrameBlock) -> int:
        """Return the time from the first frame held to the last of a block in ns."""
        return int(block.t_ns[-1] - self._t_ns[0][0]) if self.n else 0

    def push(self, block: FrameBlock) -> None:
        """Take some frames."""
        rows = self._decoder.needed(block)
        self._t_ns.append(block.t_ns)
        self._rows.append(rows + self.n)
        self._needed.append(chosen(block, rows))
        self._gaps.append(np.flatnonzero(block.key == _GAP) + self.n)
        self.n += len(block.t_ns)

    def flush(self) -> SampleBlock:
        """Pass the frames on; return the samples that are complete."""
        if not self.n:
            return self._assembler.push(_NONE)
        rows, gaps = np.concatenate(self._rows), np.concatenate(self._gaps).tolist()
        self._decoder.unmapped += self.n - len(rows) - len(gaps)
        needed = joined_frames(self._needed)
        decoded = [part._replace(rows=rows[part.rows]) for part in self._decoder.push(needed)]
        t_ns = np.concatenate(self._t_ns)
        self._clear()
        return self._assembler.push(t_ns, decoded, gaps)


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
