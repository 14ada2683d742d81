"""The progress of a training: its share of the budget, and about how long it will take."""

import math
import time
from collections.abc import Callable
from threading import Lock
from typing import TextIO

from training.cli.console.progress import Progress
from training.narx.search.structure import Try
from training.narx.work import PER_MINUTE


class Bar(Progress):
    """Counted work of all trainings side by side.

    budget_minutes : guess of the time after which the training stops
    monotonic_s : clock in s
    """

    def __init__(
        self,
        budget_minutes: float,
        out: TextIO | None = None,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(out, monotonic_s, total=100, unit="%")
        self._lock, self._tries, self._best = Lock(), 0, math.inf
        self._minutes, self._done_minutes = budget_minutes, 0.0

    def tried(self, candidate: Try) -> None:
        """Show a structure that was tried."""
        with self._lock:
            self._tries += 1
            self._best = min(self._best, candidate.rmse)
            self._show()

    def update(self, epoch: float) -> None:
        """Show the work of one more epoch."""
        with self._lock:
            self._done_minutes += epoch / PER_MINUTE
            self._show()

    @property
    def left_s(self) -> float:
        """Return the time in s that the rest of the budget takes, by the pace so far.

        A training may end long before its budget does.
        """
        rest = max(self._minutes - self._done_minutes, 0.0)
        pace_s = self.elapsed_s / self._done_minutes if self._done_minutes else 60.0
        return rest * pace_s

    def _show(self) -> None:
        left_s, share = round(self.left_s), self._done_minutes / self._minutes
        tries = f"{self._tries} structures tried, " if self._tries else ""
        best = f"best free run {self._best:.3f}, " if math.isfinite(self._best) else ""
        text = f"{tries}{best}at most about {left_s // 60}:{left_s % 60:02d} left"
        self._bar.update(100 * min(share, 1.0) - self._bar.n)
        self._bar.set_postfix_str(text)
        self.tell(f"o2train: {text}")
