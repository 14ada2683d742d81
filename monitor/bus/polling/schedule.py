"""Which PIDs are asked for next: first what is supported, then what is oldest."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from monitor.bus.polling.answer import supported
from monitor.bus.polling.pids import BITMAPS, Parameter

MOST_PIDS: Final = 6  # in one request, SAE J1979
TRY_AGAIN: Final = 60  # answers to single PIDs, after which silence is put down to lost frames
PATIENCE: Final = 3  # so often not answered, others being answered: asked alone, at last not at all


class Schedule:
    """Chooses the PIDs of each request, from what is mapped and supported.

    The oldest go first, age counted in timeouts of the signals they carry. What an ECU leaves out
    of its answers is asked for alone, and not any more if it does not answer that either.

    parameters : what is mapped
    say : takes a line about what is supported, once it is known
    """

    def __init__(
        self, parameters: Sequence[Parameter], say: Callable[[str], None] = lambda _: None
    ) -> None:
        self._parameters, self._say = tuple(parameters), say
        self._highest = max(pid for each in parameters for pid in each.pids)
        self.begin()

    def begin(self) -> None:
        """Know nothing of the ECU: the bitmaps are read first."""
        self.bitmap: int | None = BITMAPS[0]  # asked next, None when all are known
        self.timeouts_s: dict[int, float] = {}  # of what is polled
        self._supported: set[int] = set()
        self._asked_s: dict[int, float] = {}
        self._unanswered: dict[int, int] = {}  # PID → how often in a row
        self._most = MOST_PIDS
        self._try_again = 0  # answers until more are asked for at once again; 0 is never

    @property
    def is_first(self) -> bool:
        """Return whether the ECU has not answered yet."""
        return self.bitmap == BITMAPS[0]

    def choose(self, now_s: float) -> tuple[int, ...]:
        """Return the PIDs of the next request, none if nothing is supported."""
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
            oldest = [pid for pid in oldest if not self._is_alone(pid)][: self._most]
        self._asked_s.update(dict.fromkeys(oldest, now_s))
        return tuple(oldest)

    def answered(self, asked: Sequence[int], values: Mapping[int, bytes]) -> None:
        """Note which of the PIDs asked for were answered."""
        for pid in values:
            self._unanswered.pop(pid, None)
        if self.bitmap is not None:
            self._take(self.bitmap, values[self.bitmap])
            return
        if self._try_again:
            self._try_again -= 1
            self._most = 1 if self._try_again else MOST_PIDS
        missing = [pid for pid in asked if pid not in values]
        if len(missing) == len(asked) - 1 > 0:
            self._most, self._try_again = 1, 0  # this ECU answers one at a time
        self._miss(missing)

    def refused(self, asked: Sequence[int]) -> None:
        """Note that the ECU will not say."""
        if self.is_first:
            return
        if self.bitmap is not None:
            self._know()  # the ranges known so far must do
        elif len(asked) > 1:
            self._most, self._try_again = 1, 0
        else:
            self._miss(asked)

    def silent(self, asked: Sequence[int], in_a_row: int) -> None:
        """Note that nothing came."""
        if self.bitmap is not None:
            return
        if len(asked) == 1:
            self._miss(asked)
        elif in_a_row > 1:
            self._most, self._try_again = 1, TRY_AGAIN

    def _is_alone(self, pid: int) -> bool:
        return self._unanswered.get(pid, 0) >= PATIENCE

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
        """Choose what is polled, after the last bitmap."""
        self.bitmap = None
        lacks = []
        for each in self._parameters:
            pid = next((pid for pid in each.pids if pid in self._supported), None)
            if pid is None:
                lacks.append(f"{' '.join(each.names)} ({'/'.join(map(_shown, each.pids))})")
            else:
                self.timeouts_s[pid] = each.timeout_s
        polled = " ".join(map(_shown, self.timeouts_s)) or "nothing"
        self._say(
            f"OBD-II: polled are the PIDs {polled}"
            + (f"; not supported: {', '.join(lacks)}" if lacks else "")
        )


def _shown(pid: int) -> str:
    return f"{pid:02X}"
