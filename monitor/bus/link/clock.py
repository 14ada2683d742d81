"""Bus time while no frame arrives."""

import time
from collections.abc import Callable
from typing import Final

from monitor.base.types import Frame
from monitor.frames.loop_frames import time_mark

SILENCE_S: Final = 0.5  # silence after which time marks are made
FIRST_FRAME_S: Final = 10.0  # the same before the first frame; bus time is then wall-clock time
BEHIND_S: Final = 0.1  # a time mark lags by this, so that a frame arriving now is not late


class Clock:
    """Bus time on a silent bus: the last frame's time plus the time since."""

    def __init__(self, monotonic_s: Callable[[], float]) -> None:
        self._monotonic_s = monotonic_s
        self._last_ns = time.time_ns() // 1000 * 1000  # until the first frame sets it
        self._received_s = monotonic_s()
        self._heard = False

    @property
    def t_ns(self) -> int:
        """Return the bus time now; it is never before the last frame's time."""
        passed_s = self._monotonic_s() - self._received_s - BEHIND_S
        return self._last_ns + max(round(passed_s * 1e6), 0) * 1000

    def heard(self, t_ns: int, now_s: float) -> None:
        """Take the time of a frame that arrived at the monotonic time ``now_s``."""
        self._last_ns, self._received_s, self._heard = t_ns, now_s, True

    def mark(self) -> Frame | None:
        """Return a time mark if the bus has been silent long enough, otherwise None."""
        silent_s = self._monotonic_s() - self._received_s
        if silent_s < (SILENCE_S if self._heard else FIRST_FRAME_S):
            return None
        return time_mark(self.t_ns)
