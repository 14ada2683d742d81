"""Alive counters: whether messages missed frames while a whole log paused.

A sender raises the counter with every frame that it sends. Behind a pause of the whole log a
counter that goes on therefore says that no frame was missed: the clock of the log stepped. A
counter that does not go on says that frames are missing. Where the frames that a message would
have sent meanwhile are close to a multiple of the counter's length, the counter says nothing.
"""

from typing import Final, Literal

import numpy as np

from monitor.base.types import FrameBlock, IntArray
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.plan import Checks, Plan

Verdict = Literal["went on", "missed", "unknown"]
SURE_BITS: Final = 8  # counters of so many bits together go on by chance in one of 256 pauses


class AliveCounters:
    """The alive counters in a block of frames.

    decoder : knows the messages
    block : the frames; its times are read when they are needed
    """

    def __init__(self, decoder: BlockDecoder, block: FrameBlock) -> None:
        self._t_ns = block.t_ns
        plans = decoder.plans.values()
        self._counters = [_Counter(plan, block) for plan in plans if plan.counter is not None]

    def verdict(self, begin: int, at: int, end: int, pause_ns: int | None) -> Verdict:
        """Return the counters' finding on the pause before the frame ``at``.

        begin, end : the frames around the pause that are looked at; the times of those before
            ``at`` are believed
        pause_ns : length of the pause, None if it is not known
        """
        bits_on, n_on, n_missed = 0, 0, 0
        for counter in self._counters:
            goes_on = counter.goes_on(begin, at, end)
            if goes_on is None:
                continue
            if not goes_on:
                n_missed += 1
            elif pause_ns is None or counter.would_tell(begin, at, pause_ns, self._t_ns):
                n_on += 1
                bits_on += counter.bits
        if bits_on >= SURE_BITS and not n_missed:
            return "went on"
        return "missed" if n_missed > n_on else "unknown"


class _Counter:
    """The alive counter of one message: ``bits`` of it."""

    def __init__(self, plan: Plan, block: FrameBlock) -> None:
        assert plan.counter is not None
        self.bits = plan.counter.length
        mask, wanted = plan.match
        self._places = np.flatnonzero((block.key & mask) == wanted)
        counts = Checks([plan]).counters.bits(block.data[self._places], [0]).astype(np.int64)
        self._rose = np.diff(counts) % (1 << self.bits) == 1  # at each frame but the first

    def goes_on(self, begin: int, at: int, end: int) -> bool | None:
        """Return whether the counter goes on at the frame ``at``, None if it does not tell.

        It does not where too few frames lie between begin and end, or where it did not go on
        before, either.
        """
        after = int(np.searchsorted(self._places, at))
        if after < 2 or after == len(self._places) or not self._rose[after - 2]:
            return None
        if self._places[after - 2] < begin or self._places[after] >= end:
            return None
        return bool(self._rose[after - 1])

    def would_tell(self, begin: int, at: int, pause_ns: int, t_ns: IntArray) -> bool:
        """Return whether the counter would tell that no frame came for ``pause_ns``.

        t_ns : (n,) times of the block's frames; pauses among those before do not count
        """
        first, last = np.searchsorted(self._places, (begin, at)).tolist()
        period_ns = float(np.median(np.diff(t_ns[self._places[first:last]])))
        if period_ns <= 0.0:
            return False
        n_missing = round(pause_ns / period_ns) % (1 << self.bits)
        return 2 <= n_missing <= (1 << self.bits) - 2
