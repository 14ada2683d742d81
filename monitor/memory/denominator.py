"""The general denominator of a driving cycle: long enough, fast enough, and one idle."""

import math
from typing import NamedTuple

import numpy as np

from monitor.base.config import CyclesConfig
from monitor.base.types import IntArray


class Flags(NamedTuple):
    """Conditions on samples that are alike."""

    moves: bool  # fast enough for the general denominator
    idles: bool
    fits: bool  # neither too cold nor too high for the general denominator
    is_warm: bool


class DrivenSpan:
    """Samples begin to end of a block, and the time that passes in them."""

    def __init__(self, begin: int, end: int, until_ns: IntArray) -> None:
        self.begin, self.end, self._until_ns = begin, end, until_ns
        self._before_ns = until_ns.item(begin)  # until_ns[k + 1] includes sample k
        self.elapsed_ns = until_ns.item(end) - self._before_ns

    def reached(self, sum_ns: int, least_ns: int) -> int | None:
        """Return at which sample a sum, so far ``sum_ns``, has come to ``least_ns``."""
        if sum_ns >= least_ns:
            return self.begin
        if sum_ns + self.elapsed_ns < least_ns:
            return None
        if self.end - self.begin == 1:
            return self.begin
        inside = self._until_ns[self.begin + 1 : self.end + 1]
        return self.begin + int(np.searchsorted(inside, least_ns - sum_ns + self._before_ns))


class Denominator:
    """The general denominator of one driving cycle: long enough, fast enough, and one idle."""

    def __init__(self, config: CyclesConfig) -> None:
        self._run_least_ns, self._moving_least_ns, self._idle_least_ns = map(
            whole_ns,
            (config.denominator_run_s, config.denominator_moving_s, config.denominator_idle_s),
        )
        self._run_ns = self._moving_ns = self._idle_ns = 0
        self._has_idled = False

    def interrupt(self) -> None:
        """End the idling."""
        self._idle_ns = 0

    def push(self, span: DrivenSpan, flags: Flags) -> int | None:
        """Take samples that are alike, the engine running; return where all is reached."""
        if not flags.fits:
            self._idle_ns = 0
            return None
        moves_ns, idles_ns = (span.elapsed_ns * on for on in (flags.moves, flags.idles))
        self._idle_ns *= flags.idles
        at = (
            span.reached(self._run_ns, self._run_least_ns),
            self._reached(span, self._moving_ns, self._moving_least_ns, on=flags.moves),
            span.begin
            if self._has_idled
            else self._reached(span, self._idle_ns, self._idle_least_ns, on=flags.idles),
        )
        self._run_ns += span.elapsed_ns
        self._moving_ns += moves_ns
        self._idle_ns += idles_ns
        self._has_idled |= at[2] is not None
        reached = [k for k in at if k is not None]
        return max(reached) if len(reached) == len(at) else None

    def _reached(self, span: DrivenSpan, sum_ns: int, least_ns: int, *, on: bool) -> int | None:
        if on:
            return span.reached(sum_ns, least_ns)
        return span.begin if sum_ns >= least_ns else None


def whole_ns(seconds: float) -> int:
    """Return whole nanoseconds; as many as no drive has for an infinite time."""
    return round(seconds * 1e9) if math.isfinite(seconds) else 1 << 62
