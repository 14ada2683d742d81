"""Bus time of the live loop, measured against a monotonic clock.

A frame's time is believed unless it cannot be: no frame is stamped later than it arrives, and none
much earlier than the one before. The time of such a frame is that of its arrival. If some in a row
agree with each other, the clock of the interface was set: later times are moved so that they go on.
If not, they were outliers. While no frame arrives, time marks move time on; a pause in which
values go stale ends with one, so that a replay of the recording believes it.
"""

import time
from collections.abc import Callable
from itertools import chain
from typing import Final

from monitor.base.types import Frame, FrameBlock
from monitor.frames.blocks import block_of, frames_of
from monitor.frames.loop_frames import time_mark
from monitor.grid.block_assembler import LATEST_NS
from monitor.grid.time_walk import TimeCounters, wrapped

SILENCE_S: Final = 0.5  # silence after which time marks are made
FIRST_FRAME_S: Final = 10.0  # the same before the first frame; bus time is then wall-clock time
BEHIND_S: Final = 0.1  # a time mark lags by this, so that a frame arriving now is not late
AGREEING: Final = 10  # doubtful frames in a row with one new time that mean a clock step
EARLY_S: Final = 0.2  # so much earlier than any other a frame may seem to arrive
DRIFT: Final = 1e-3  # by which the interface's clock and the monotonic clock may differ


class Clock:
    """Believed bus time.

    monotonic_s : measures the silence of the bus, in s
    pause_ns : shortest pause in which a value goes stale
    """

    def __init__(self, monotonic_s: Callable[[], float], pause_ns: int) -> None:
        self.counters = TimeCounters()
        self.shift_ns = 0  # believed time is the frame's time less this
        self._monotonic_s, self._pause_ns = monotonic_s, pause_ns
        self._last_ns = time.time_ns() // 1000 * 1000  # of the frames; until the first now
        self._newest_ns = self._last_ns  # of the frames and marks
        self._received_s = monotonic_s()
        self._heard = self._has_made = False
        self._lead_s = 0.0  # of frame times over the clock
        self._doubted_ns, self._doubted_s, self._n_doubted = 0, 0.0, 0

    @property
    def t_ns(self) -> int:
        """Return the bus time now; it is never before the last frame's or mark's time."""
        passed_s = self._monotonic_s() - self._received_s - BEHIND_S
        return max(self._last_ns + max(round(passed_s * 1e6), 0) * 1000, self._newest_ns)

    def believed(self, block: FrameBlock, now_s: float) -> FrameBlock:
        """Return frames that have arrived by ``now_s`` at their believed times, with time marks."""
        t_ns, last_ns = block.t_ns, int(block.t_ns[-1]) - self.shift_ns
        first_ns = int(t_ns[0]) - self.shift_ns - self._newest_ns
        steps_ns = t_ns[1:] - t_ns[:-1]
        least_ns, most_ns = int(steps_ns.min(initial=0)), int(steps_ns.max(initial=0))
        is_calm = min(first_ns, least_ns) >= 0 and max(first_ns, most_ns) <= self._pause_ns
        lead_s = int(t_ns[-1]) * 1e-9 - now_s
        if not (self._heard and is_calm and lead_s <= self._lead_s + EARLY_S):
            frames = (self.weighed(frame, now_s) for frame in frames_of(block))
            return block_of(list(chain.from_iterable(frames)))
        self._newest_ns = last_ns
        self._believe(last_ns, now_s, lead_s)
        return block._replace(t_ns=t_ns - wrapped(self.shift_ns)) if self.shift_ns else block

    def weighed(self, frame: Frame, now_s: float) -> list[Frame]:
        """Return the frame at its believed time, behind a time mark if it ends a pause."""
        if not self._heard:
            self._begin(frame.t_ns, now_s)
        t_ns = frame.t_ns - self.shift_ns
        lead_s = frame.t_ns * 1e-9 - now_s
        if t_ns < self._last_ns - self._pause_ns or lead_s > self._lead_s + EARLY_S:
            t_ns = self._doubt(frame.t_ns, now_s)
        else:
            self._believe(t_ns, now_s, lead_s)
        t_ns = max(t_ns, self._newest_ns - self._pause_ns)  # it came long after a mark: it is late
        frame = frame._replace(t_ns=t_ns)
        ends_pause = t_ns > self._newest_ns + self._pause_ns
        self._newest_ns = max(self._newest_ns, t_ns)
        return [time_mark(t_ns), frame] if ends_pause else [frame]

    def _begin(self, t_ns: int, now_s: float) -> None:
        """Take the first frame\'s time, but let it not break with time marks made before."""
        self._heard = True
        is_strange = abs(t_ns) >= LATEST_NS
        if is_strange or (self._has_made and abs(t_ns - self.t_ns) > self._pause_ns):
            self.shift_ns = t_ns - self.t_ns
        else:
            self._newest_ns = self._last_ns = t_ns
        self._received_s = now_s
        self._lead_s = t_ns * 1e-9 - now_s

    def _believe(self, t_ns: int, now_s: float, lead_s: float) -> None:
        """Go on from a believed time.

        lead_s : of the interface\'s clock over the monotonic one
        """
        self.counters.outliers += self._n_doubted
        self._n_doubted = 0
        # by the frames' own time, since many may arrive at once behind a long wait
        passed_s = max(t_ns - self._last_ns, 0) * 1e-9
        self._last_ns, self._received_s = max(t_ns, self._last_ns), now_s
        self._lead_s = max(lead_s, self._lead_s - DRIFT * passed_s)

    def _doubt(self, raw_ns: int, now_s: float) -> int:
        """Return the time of arrival of a frame whose time cannot be; note a clock step."""
        passed_ns = raw_ns - self._doubted_ns
        longest_ns = self._pause_ns + round((now_s - self._doubted_s) * 1e9)
        if self._n_doubted and not -self._pause_ns <= passed_ns <= longest_ns:
            self.counters.outliers += self._n_doubted
            self._n_doubted = 0
        self._n_doubted += 1
        self._doubted_ns, self._doubted_s = raw_ns, now_s
        t_ns = self.t_ns
        if self._n_doubted == AGREEING:
            self.counters.clock_steps += 1
            self._n_doubted = 0
            self.shift_ns = raw_ns - t_ns
            self._lead_s = raw_ns * 1e-9 - now_s
            self._believe(t_ns, now_s, self._lead_s)
        return t_ns

    def made(self) -> int:
        """Return the bus time of a frame that the loop makes now."""
        self._has_made = True
        self._newest_ns = self.t_ns
        return self._newest_ns

    def slept(self) -> int:
        """Return the bus time behind a suspension of the machine; the next frame begins there."""
        self.counters.log_gaps += 1
        t_ns = self.made()
        self._heard, self.shift_ns = False, 0
        return t_ns

    def mark(self) -> Frame | None:
        """Return a time mark if the bus has been silent long enough, otherwise None."""
        silent_s = self._monotonic_s() - self._received_s
        if silent_s < (SILENCE_S if self._heard else FIRST_FRAME_S):
            return None
        return time_mark(self.made())
