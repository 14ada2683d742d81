"""The latest frames of a log, for those that follow to be compared with."""

from collections import deque
from typing import Final

from monitor.base.types import FrameBlock
from monitor.frames.blocks import joined

KEPT: Final = 1 << 16  # 16 s of a full bus of 500 kbit/s; stretches of a log may be out of order


class RecentFrames:
    """The latest frames of a log, at least ``KEPT`` of them if so many came."""

    def __init__(self) -> None:
        self._blocks: deque[FrameBlock] = deque()
        self._n = 0

    def push(self, block: FrameBlock) -> None:
        """Take the next frames; forget those of long ago."""
        self._blocks.append(block)
        self._n += len(block.t_ns)
        while self._n - len(self._blocks[0].t_ns) >= KEPT:
            self._n -= len(self._blocks.popleft().t_ns)

    def before(self, frames: FrameBlock) -> tuple[FrameBlock, int]:
        """Return the latest frames and those that follow as one block, and how many are before."""
        if self._n:
            latest = joined(list(self._blocks))
            self._blocks = deque([latest])
            frames = joined([latest, frames])
        return frames, self._n
