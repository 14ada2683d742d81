"""The progress of a training with several starts at once."""

import math
import time
from collections.abc import Callable
from threading import Lock
from typing import TextIO

from training.cli.console.progress import Progress
from training.narx.search.stages import EPOCHS, HORIZONS
from training.narx.search.structure import Try


class Bar(Progress):
    """Epochs of all starts; a stage that ends early counts with all its epochs.

    budget_minutes : guess of the time after which the training stops
    monotonic_s : clock in s
    """

    def __init__(
        self,
        budget_minutes: float,
        out: TextIO | None = None,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(out, monotonic_s, unit="epoch")
        self._lock, self._tries = Lock(), 0
        self._before = {h: EPOCHS * i for i, h in enumerate((1, *HORIZONS))}
        self._at: dict[int, int] = {}
        self._best = float("inf")
        self._first_s: float | None = None  # when the first epoch ended
        self._budget_s = 60.0 * budget_minutes

    def tried(self, candidate: Try) -> None:
        """Show a structure that was tried."""
        with self._lock:
            self._tries += 1
            self._best = min(self._best, candidate.rmse)
            self._show(f"{self._tries} structures tried")

    def update(self, start: int, horizon: int, epoch: int, best: float) -> None:
        """Show one epoch of one start and its best validation RMSE (scaled)."""
        with self._lock:
            if self._first_s is None:
                self._first_s, self._best = self.elapsed_s, best  # of the training, not the tries
            at = self._before.get(horizon, 0) + epoch + 1
            self._bar.update(at - self._at.get(start, 0))
            self._at[start], self._best = at, min(self._best, best)
            self._bar.total = self._total
            self._show(f"horizon {horizon}")

    @property
    def _total(self) -> int:
        return len(self._at) * EPOCHS * len(self._before)

    @property
    def left_s(self) -> float:
        """Return the time left in s: by the epochs so far, at most the rest of the guess."""
        elapsed_s, done = self.elapsed_s, sum(self._at.values())
        rest_s = max(self._budget_s - elapsed_s, 0.0)
        if self._first_s is None or done < len(self._at) + 1:
            return rest_s
        per_epoch_s = (elapsed_s - self._first_s) / (done - 1)
        return min(rest_s, per_epoch_s * max(self._total - done, 0))

    def _show(self, what: str) -> None:
        left_s = round(self.left_s)
        best = f", best free run {self._best:.3f}" if math.isfinite(self._best) else ""
        text = f"{what}{best}, about {left_s // 60}:{left_s % 60:02d} left"
        self._bar.set_postfix_str(text)
        self.tell(f"o2train: {text}")
