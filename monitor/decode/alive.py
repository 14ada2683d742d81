"""Alive counters: whether messages missed frames while a whole log paused.

A sender raises the counter with every frame that it sends. Behind a pause of the whole log a
counter that goes on therefore says that no frame was missed: the clock of the log stepped. A
counter that does not go on says that frames are missing. Where the frames that a message would
have sent meanwhile are close to a multiple of the counter's length, the counter says nothing.
"""

from collections.abc import Callable
from typing import Final, Literal

import numpy as np

from monitor.base.types import FrameBlock, IntArray
from monitor.decode.block_decoder import BlockDecoder, Payloads, Plan

Verdict = Literal["went on", "missed", "unknown"]
SURE_BITS: Final = 8  # counters of so many bits together go on by chance in one of 256 pauses
_KNOWN: Final = 3  # frames of a message before the pause that are looked at


class AliveCounters:
    """Reads the alive counters of the messages that a decoder needs."""

    def __init__(self, decoder: BlockDecoder) -> None:
        self._plans = [plan for plan in decoder.plans.values() if plan.counter is not None]

    def verdict(
        self, block: FrameBlock, begin: int, at: int, end: int, pause_ns: int | None
    ) -> Verdict:
        """Return what the counters say of the pause before the frame ``at``.

        block : frames around the pause, those from begin to end are looked at; the times of those
            before ``at`` are believed
        pause_ns : length of the pause, None if it is not known
        """
        bits_on, n_on, n_missed = 0, 0, 0
        for plan in self._plans:
            mask, wanted = plan.match
            places = begin + np.flatnonzero((block.key[begin:end] & mask) == wanted)
            n_before = int(np.searchsorted(places, at))
            before, after = places[:n_before], places[n_before:]
            steps = _steps(plan, block, before[-_KNOWN:], after[:_KNOWN])
            if steps is None:
                continue
            counted, came, length = steps
            if counted != came:
                n_missed += 1
            elif pause_ns is None or _would_tell(block.t_ns[before], pause_ns, length):
                n_on += 1
                bits_on += length
        if bits_on >= SURE_BITS and 2 * n_missed < n_on:
            return "went on"
        return "missed" if n_missed > n_on else "unknown"


def _steps(
    plan: Plan, block: FrameBlock, before: IntArray, after: IntArray
) -> tuple[int, int, int] | None:
    """Return by how much a counter rose over the pause, how many frames came, and its bits.

    None where the message does not tell: too few frames, or a counter that did not rise by one
    with each frame before.

    before, after : places of the message's frames around the pause, ascending
    """
    places = np.concatenate([before, after])
    assert plan.counter is not None
    data = plan.payload(block.data[places])
    sound = np.flatnonzero(plan.fits(block.length[places]) & plan.holds(data))
    first_after = int(np.searchsorted(sound, len(before)))
    if first_after < 2 or first_after == len(sound):
        return None
    length = plan.counter.length
    counts = plan.count(Payloads(plan.message, data[sound])).tolist()
    rise: Callable[[int], int] = lambda k: (counts[k] - counts[k - 1]) % (1 << length)  # noqa: E731
    came = [int(n) % (1 << length) for n in np.diff(sound)]
    if rise(first_after - 1) != came[first_after - 2]:
        return None
    return rise(first_after), came[first_after - 1], length


def _would_tell(before_ns: IntArray, pause_ns: int, length: int) -> bool:
    """Return whether a counter would tell that no frame came for ``pause_ns``.

    before_ns : times of the message's frames before, (n,) at least two; pauses among them
        do not count
    """
    intervals_ns = np.diff(before_ns)
    usual_ns = float(np.median(intervals_ns))
    period_ns = float(intervals_ns[intervals_ns <= 2.0 * usual_ns].mean())
    if period_ns <= 0.0:
        return False
    n_missing = round(pause_ns / period_ns) % (1 << length)
    return 2 <= n_missing <= (1 << length) - 2
