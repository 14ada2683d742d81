"""The latest frames of a log, for those that follow to be compared with."""

from collections import deque
from typing import Final

import numpy as np

from monitor.base.types import FrameBlock, IntArray
from monitor.frames.blocks import joined

KEPT: Final = 1 << 16  # 16 s of a full bus of 500 kbit/s; stretches of a log may be out of order


class RecentFrames:
    """The latest frames of a log, at least ``KEPT`` of them if so many came."""

    def __init__(self) -> None:
        self._blocks: deque[FrameBlock] = deque()
        self._raw_ns: deque[IntArray] = deque()  # of each block, as the log has them
        self._n = 0

    def push(self, block: FrameBlock, raw_ns: IntArray) -> None:
        """Take the next frames and their times in the log; forget those of long ago."""
        self._blocks.append(block)
        self._raw_ns.append(raw_ns)
        self._n += len(block.t_ns)
        while self._n - len(self._blocks[0].t_ns) >= KEPT:
            self._n -= len(self._blocks.popleft().t_ns)
            self._raw_ns.popleft()

    def before(self, frames: FrameBlock) -> tuple[FrameBlock, IntArray, int]:
        """Return the latest frames and those that follow as one block.

        Also return all their times in the log, and how many frames are before.
        """
        raw_ns = frames.t_ns
        if self._n:
            latest, latest_ns = joined(list(self._blocks)), np.concatenate(self._raw_ns)
            self._blocks, self._raw_ns = deque([latest]), deque([latest_ns])
            frames, raw_ns = joined([latest, frames]), np.concatenate([latest_ns, raw_ns])
        return frames, raw_ns, self._n
