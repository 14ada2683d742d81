"""Logs as blocks of frames: the frames, counters and errors of ``sources.read_frames``."""

from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np

from monitor.candump import LogCounters
from monitor.errors import RecordingError
from monitor.sources import read_frames
from monitor.types import Frame, FrameBlock

FRAMES: Final = 1 << 16  # in a block
_EXTENDED: Final = 1 << 31


def read_blocks(path: str | Path, counters: LogCounters | None = None) -> Iterator[FrameBlock]:
    """Return the frames of the log ``path`` in the order of the file, many at a time.

    counters : is kept up to date, block by block
    Raises RecordingError as ``sources.read_frames`` does, after the frames before the damage.
    """
    return blocks_of(read_frames(path, counters))


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
        np.array([f.can_id | f.is_extended * _EXTENDED for f in frames], dtype=np.uint32),
        np.array(lengths, dtype=np.uint8),
        np.frombuffer(data, dtype=np.uint8).reshape(len(frames), width),
    )
