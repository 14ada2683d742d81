"""Values to samples: everything that arrives, brought onto one fixed grid.

Tick k stands at t0 + k * period in integer nanoseconds, t0 being the time of the first frame.
Sample k >= 1 holds for each signal the mean of the good values received in (t_(k-1), t_k], the
first frames' own time included in sample 1; averaging keeps fast signals from folding back. If
only bad values came, the sample says so; if none came, the last tick's value is held until it is
older than the signal's timeout, then it is stale. Sample k leaves when the first frame after t_k
arrives; any frame moves time, whether its signals are wanted or not. Behind a pause of the whole
log of which nothing is known the grid begins anew, and a signal is stale only after its timeout.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from monitor.base.errors import SignalMapError
from monitor.base.types import Quality, Sample
from monitor.decode.decoder import Decoder
from monitor.decode.open_tick import Received
from monitor.decode.signal_map import Derived
from monitor.frames.candump import LATEST_S
from monitor.grid.derived import Output

MAX_JUMP_NS = 60_000_000_000  # a longer pause is a break in the recording, not a gap
LATEST_NS = int(LATEST_S * 1e9)
MAX_LATE = 100  # so many late frames in a row mean that the clock went backwards

_NAN = math.nan
_GOOD, _STALE, _OFF_BUS, _GAP = (
    int(quality) for quality in (Quality.GOOD, Quality.STALE, Quality.OFF_BUS, Quality.GAP)
)
_NEVER_NS = -(1 << 64)


@dataclass(slots=True)
class AssemblerCounters:
    """Counts of the frames by the fate of their times."""

    late: int = 0  # dropped: older than the open tick, or a time that no clock shows
    discontinuities: int = 0  # times the grid was anchored anew


class Assembler:
    """Collects the values of frames into samples on a grid.

    channels : names of what the updates carry, in the order of their indices
    names : what a sample holds, each a channel or a derived signal
    period_ns : grid period, above 0 and at most MAX_JUMP_NS
    timeouts_ns : how long the value of each channel may be held
    received : where the values of the open tick are added; by default of its own
    """

    def __init__(
        self,
        channels: Sequence[str],
        names: Sequence[str],
        period_ns: int,
        timeouts_ns: Sequence[int],
        derived: Sequence[Derived] = (),
        received: Received | None = None,
    ) -> None:
        check_grid(period_ns)
        n = len(channels)
        if len(timeouts_ns) != n:
            raise SignalMapError(f"{n} channels have {len(timeouts_ns)} timeouts")
        self.names = tuple(names)
        self.period_ns = period_ns
        self.counters = AssemblerCounters()
        self.is_off_bus = False  # the monitor itself hears nothing: no sender is to blame
        self._timeouts_ns = list(timeouts_ns)
        self._output = Output(channels, names, derived)
        self.received = Received(n) if received is None else received
        self._held = [_NAN] * n
        self._held_quality = [_STALE] * n
        self._index = 1  # of the open tick
        self._is_anchored = False
        self._first_ns, self._end_ns = 1, 0  # the open tick is [first, end]
        self._last_ns = 1  # time of the latest frame
        self._late_in_a_row = 0
        self._gap_ns = (
            _NEVER_NS  # end of a pause of which nothing is known, if the grid began there
        )

    @classmethod
    def of(cls, decoder: Decoder, period_ns: int) -> "Assembler":
        """Return an assembler that takes the values of ``decoder``."""
        timeouts_ns, received = decoder.timeouts_ns, decoder.received
        return cls(
            channels=decoder.channels,
            names=decoder.names,
            period_ns=period_ns,
            timeouts_ns=timeouts_ns,
            derived=decoder.derived,
            received=received,
        )

    @property
    def tick_end_ns(self) -> int:
        """Return the end of the open tick, 0 before the first frame."""
        return self._end_ns

    def advance(self, t_ns: int) -> Sequence[Sample] | None:
        """Take the time of a frame and return the samples that are complete before it.

        Every frame moves time, even without a signal of the model. Returns None if the frame is
        too late for the open tick, or its time is beyond 64 bits: then its values must not be
        added to ``received``.
        """
        if self._last_ns <= t_ns <= self._end_ns:  # in order, within the open tick
            self._last_ns = t_ns
            self._late_in_a_row = 0
            return ()
        if abs(t_ns) >= LATEST_NS:
            self.counters.late += 1
            return None
        if t_ns > self._end_ns or not self._is_anchored:
            samples = self._close_until(t_ns)
        elif t_ns >= self._first_ns:
            samples = ()
        else:
            self.counters.late += 1
            self._late_in_a_row += 1
            if self._late_in_a_row < MAX_LATE:
                return None
            samples = [self._break(t_ns)]
        self._late_in_a_row = 0
        self._last_ns = max(self._last_ns, t_ns)
        return samples

    def gap(self, t_ns: int) -> Sequence[Sample]:
        """Begin anew behind a pause that ends at ``t_ns``, of which nothing is known.

        Returns the all-gap sample that marks it; what the open tick holds is forgotten.
        """
        self._late_in_a_row = 0
        if not self._is_anchored:
            self._anchor(t_ns)
            return ()
        return [self._break(t_ns, _GAP)]

    def reset(self) -> None:
        """Forget everything but the statistics; the next frame starts a new grid at tick 1."""
        self._clear(_STALE)
        self._gap_ns = _NEVER_NS
        self._index = 1
        self._is_anchored = False
        self._first_ns, self._end_ns, self._last_ns = 1, 0, 1
        self._late_in_a_row = 0

    def _close_until(self, t_ns: int) -> Sequence[Sample]:
        """Close every tick that ends before ``t_ns``."""
        if not self._is_anchored:
            self._anchor(t_ns)
            return ()
        samples = []
        if t_ns - self._last_ns > MAX_JUMP_NS:
            samples.append(self._close())
            samples.append(self._break(t_ns))
            return samples
        while t_ns > self._end_ns:
            samples.append(self._close())
        return samples

    def _anchor(self, t_ns: int) -> None:
        """Open a tick that includes ``t_ns`` itself."""
        self._is_anchored = True
        self._first_ns = self._last_ns = t_ns
        self._end_ns = t_ns + self.period_ns

    def _break(self, t_ns: int, quality: int = _STALE) -> Sample:
        """Anchor the grid at ``t_ns`` and return the sample without values that marks the break."""
        self.counters.discontinuities += 1
        self._clear(quality)
        self._anchor(t_ns)
        self._gap_ns = t_ns if quality == _GAP else _NEVER_NS
        n = len(self.names)
        sample = Sample(self._index, t_ns, np.full(n, np.nan), np.full(n, quality, dtype=np.uint8))
        self._index += 1
        return sample

    def _clear(self, quality: int) -> None:
        n = len(self._held)
        self.received.clear()
        self._held[:] = [_NAN] * n
        self._held_quality[:] = [quality] * n

    def _close(self) -> Sample:
        """Return the open tick's sample and open the next."""
        values, quality, received = self._held, self._held_quality, self.received
        sums, worst, times_ns = received.sums, received.worst, received.times_ns
        end_ns, since_gap_ns = self._end_ns, self._end_ns - self._gap_ns
        for channel, good in enumerate(received.goods):
            if good:
                values[channel] = sums[channel] / good
                quality[channel] = _GOOD
            elif worst[channel]:
                values[channel] = _NAN
                quality[channel] = worst[channel]
            elif end_ns - times_ns[channel] > self._timeouts_ns[channel]:
                values[channel] = _NAN
                quality[channel] = _GAP if since_gap_ns <= self._timeouts_ns[channel] else _STALE
                if self.is_off_bus:
                    quality[channel] = _OFF_BUS
        received.clear()
        sample = Sample(self._index, end_ns, *self._output.of(values, quality))
        self._index += 1
        self._first_ns = end_ns + 1
        self._end_ns = end_ns + self.period_ns
        return sample


def check_grid(period_ns: int) -> None:
    """Raise SignalMapError if ``period_ns`` cannot be the period of a grid."""
    if not 0 < period_ns <= MAX_JUMP_NS:
        raise SignalMapError(
            f"a sample period of {period_ns / 1e9:g} s, above 0 and at most "
            f"{MAX_JUMP_NS / 1e9:g} s is wanted"
        )
