"""Choice of the next PIDs to poll: first the support bitmaps, then the oldest values."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from monitor.bus.polling.answer import supported
from monitor.bus.polling.pids import BITMAPS, MOST_PIDS, ObdParameter
from monitor.decode.obd_answers import N_BYTES

SINGLE: Final = 60  # answers to single PIDs after which several are requested again
PATIENCE: Final = 3  # missing answers after which a PID is polled alone; twice as many drop it


class Schedule:
    """Chooses the PIDs of each request from the mapped and supported ones.

    The oldest come first; age counts in timeouts of the signals. A PID that the ECU leaves out of
    its answers is polled alone, and dropped if it stays unanswered; so is one of unknown length.

    parameters : the mapped parameters
    say : receives a line about the supported parameters
    """

    def __init__(
        self, parameters: Sequence[ObdParameter], say: Callable[[str], None] = lambda _: None
    ) -> None:
        self.parameters, self._say = tuple(parameters), say
        self._highest = max(pid for parameter in parameters for pid in parameter.pids)
        self.begin()

    def begin(self) -> None:
        """Forget the ECU; the bitmaps are read first."""
        self.bitmap: int | None = BITMAPS[0]  # next bitmap to read, None when all are read
        self.timeouts_s: dict[int, float] = {}  # PID → timeout of its signals
        self._supported: set[int] = set()
        self._asked_s: dict[int, float] = {}
        self._unanswered: dict[int, int] = {}  # PID → missing answers in a row
        self._single = 0  # answers until several PIDs are requested at once again

    def choose(self, now_s: float) -> tuple[int, ...]:
        """Return the PIDs of the next request, none if no PID is supported."""
        if self.bitmap is not None:
            return (self.bitmap,)
        age = {
            pid: (now_s - self._asked_s.get(pid, -math.inf)) / timeout_s
            for pid, timeout_s in self.timeouts_s.items()
        }
        oldest = sorted(age, key=lambda pid: -age[pid])
        if oldest and self._is_alone(oldest[0]):
            oldest = oldest[:1]
        else:
            most = 1 if self._single else MOST_PIDS
            oldest = [pid for pid in oldest if not self._is_alone(pid)][:most]
        self._asked_s.update(dict.fromkeys(oldest, now_s))
        return tuple(oldest)

    def answered(self, asked: Sequence[int], values: Mapping[int, bytes]) -> None:
        """Record the answered PIDs of a request."""
        for pid in values:
            self._unanswered.pop(pid, None)
        if self.bitmap is not None:
            self._take(self.bitmap, values[self.bitmap])
            return
        self._single = max(self._single - 1, 0)
        missing = [pid for pid in asked if pid not in values]
        if len(missing) == len(asked) - 1 > 0:
            self._single = SINGLE  # an ECU that answers one at a time, or another tester's answer
        self._miss(missing)

    def refused(self, asked: Sequence[int]) -> None:
        """Record a negative answer."""
        if self.bitmap == BITMAPS[0]:  # it has not answered yet
            return
        if self.bitmap is not None:
            self._know()  # the ranges read so far must do
        elif len(asked) > 1:
            self._single = SINGLE
        else:
            self._miss(asked)

    def silent(self, asked: Sequence[int], in_a_row: int) -> None:
        """Record a request without an answer; several in a row are like a refusal."""
        patience = min(len(asked), 2) if self.bitmap is None else PATIENCE
        if in_a_row >= patience:
            self.refused(asked)

    def _is_alone(self, pid: int) -> bool:
        return pid not in N_BYTES or self._unanswered.get(pid, 0) >= PATIENCE

    def _miss(self, pids: Sequence[int]) -> None:
        for pid in pids:
            self._unanswered[pid] = self._unanswered.get(pid, 0) + 1
            if self._unanswered[pid] >= 2 * PATIENCE:
                self.timeouts_s.pop(pid, None)

    def _take(self, bitmap: int, data: bytes) -> None:
        self._supported |= supported(bitmap, data)
        after = bitmap + 0x20
        if after in BITMAPS and after in self._supported and after < self._highest:
            self.bitmap = after
        else:
            self._know()

    def _know(self) -> None:
        """Choose the PIDs to poll, after the last bitmap."""
        self.bitmap = None
        lacks = []
        for parameter in self.parameters:
            pid = next((pid for pid in parameter.pids if pid in self._supported), None)
            if pid is None and parameter.names:
                pids = "/".join(map(_shown, parameter.pids))
                lacks.append(f"{' '.join(parameter.names)} ({pids})")
            elif pid is not None:
                self.timeouts_s[pid] = parameter.timeout_s
        polled = " ".join(map(_shown, self.timeouts_s)) or "nothing"
        self._say(
            f"OBD-II: polled are the PIDs {polled}"
            + (f"; not supported: {', '.join(lacks)}" if lacks else "")
        )


def _shown(pid: int) -> str:
    return f"{pid:02X}"
