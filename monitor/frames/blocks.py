"""Frames one by one as blocks of frames side by side."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from typing import Final

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.types import BoolArray, Frame, FrameBlock, IntArray

EXTENDED: Final = 1 << 31  # in a block's keys: an identifier of 29 bits
FRAMES: Final = 1 << 16  # in a block


def blocks_of(frames: Iterable[Frame]) -> Iterator[FrameBlock]:
    """Yield frames side by side; those before a RecordingError come before it."""
    source = iter(frames)
    while True:
        found: list[Frame] = []
        try:
            found.extend(islice(source, FRAMES))
        except RecordingError:
            if found:
                yield block_of(found)
            raise
        if not found:
            return
        yield block_of(found)


def block_of(frames: list[Frame]) -> FrameBlock:
    """Return frames side by side."""
    lengths = [len(frame.data) for frame in frames]
    width = 8 if max(lengths, default=0) <= 8 else 64
    data = b"".join([frame.data.ljust(width, b"\0") for frame in frames])
    return FrameBlock(
        np.array([frame.t_ns for frame in frames], dtype=np.int64),
        np.array([f.can_id | f.is_extended * EXTENDED for f in frames], dtype=np.uint32),
        np.array(lengths, dtype=np.uint8),
        np.frombuffer(data, dtype=np.uint8).reshape(len(frames), width),
    )


def frames_of(block: FrameBlock) -> Iterator[Frame]:
    """Yield the frames of a block one by one."""
    new, width, data = tuple.__new__, block.data.shape[1], block.data.tobytes()
    rows = zip(block.t_ns.tolist(), block.key.tolist(), block.length.tolist(), strict=True)
    for row, (t_ns, key, length) in enumerate(rows):
        payload = data[row * width : row * width + length]
        yield new(Frame, (t_ns, key & (EXTENDED - 1), key >= EXTENDED, payload))


def chosen(block: FrameBlock, rows: slice | BoolArray | IntArray) -> FrameBlock:
    """Return some frames of a block."""
    return FrameBlock(block.t_ns[rows], block.key[rows], block.length[rows], block.data[rows])


def joined(blocks: Sequence[FrameBlock]) -> FrameBlock:
    """Return one block behind the other."""
    width = max(block.data.shape[1] for block in blocks)
    return FrameBlock(
        np.concatenate([block.t_ns for block in blocks]),
        np.concatenate([block.key for block in blocks]),
        np.concatenate([block.length for block in blocks]),
        np.concatenate([widened(block, width).data for block in blocks]),
    )


def put(block: FrameBlock, rows: list[int], found: FrameBlock) -> FrameBlock:
    """Put ``found`` into the rows of a block; return the block, wider if it must be."""
    width = max(block.data.shape[1], found.data.shape[1])
    block, found = widened(block, width), widened(found, width)
    block.t_ns[rows] = found.t_ns
    block.key[rows] = found.key
    block.length[rows] = found.length
    block.data[rows] = found.data
    return block


def widened(block: FrameBlock, width: int) -> FrameBlock:
    """Return the block with room for ``width`` bytes of data."""
    n, now = block.data.shape
    if now == width:
        return block
    data = np.zeros((n, width), dtype=np.uint8)
    data[:, :now] = block.data
    return block._replace(data=data)
