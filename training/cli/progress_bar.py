"""The progress of a training with several starts at once, on the standard error.

A terminal shows a bar; a file or pipe gets a line now and then. Both tell the best error so far and
the time that is left.
"""

import sys
import time
from collections.abc import Callable
from threading import Lock
from types import TracebackType
from typing import Final, TextIO

from tqdm import tqdm

from training.narx.stages import EPOCHS
from training.narx.structure import Try

LINE_S: Final = 30.0  # between two lines where there is no terminal


class Bar:
    """Epochs of all starts; a stage that ends early counts with all its epochs.

    budget_minutes : after which the training stops
    monotonic_s : clock in s
    """

    def __init__(
        self,
        budget_minutes: float,
        out: TextIO | None = None,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._out = out or sys.stderr
        self._bar = tqdm(unit="epoch", leave=False, disable=None, file=self._out)
        self._lock, self._tries = Lock(), 0
        self._before = {h: sum(n for g, n in EPOCHS.items() if g < h) for h in EPOCHS}
        self._at: dict[int, int] = {}
        self._best = float("inf")
        self._now_s, self._began_s = monotonic_s, monotonic_s()
        self._first_s: float | None = None  # when the first epoch ended
        self._budget_s, self._told_s = 60.0 * budget_minutes, self._began_s

    def __enter__(self) -> "Bar":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.close()

    def tried(self, candidate: Try) -> None:
        """Show a structure that was tried."""
        with self._lock:
            self._tries += 1
            self._best = min(self._best, candidate.rmse)
            self._tell(f"{self._tries} structures tried")

    def update(self, start: int, horizon: int, epoch: int, best: float) -> None:
        """Show one epoch of one start and its best validation RMSE (scaled)."""
        with self._lock:
            if self._first_s is None:
                self._first_s, self._best = self._now_s(), best  # of the training, not the tries
            at = self._before.get(horizon, 0) + epoch + 1
            self._bar.update(at - self._at.get(start, 0))
            self._at[start], self._best = at, min(self._best, best)
            self._bar.total = self._total
            self._tell(f"horizon {horizon}")

    @property
    def _total(self) -> int:
        return len(self._at) * sum(EPOCHS.values())

    @property
    def left_s(self) -> float:
        """Return the time left in s: by the epochs so far, at most the rest of the budget."""
        now_s, done = self._now_s(), sum(self._at.values())
        rest_s = max(self._budget_s - (now_s - self._began_s), 0.0)
        if self._first_s is None or done < len(self._at) + 1:
            return rest_s
        per_epoch_s = (now_s - self._first_s) / (done - 1)
        return min(rest_s, per_epoch_s * max(self._total - done, 0))

    def _tell(self, what: str) -> None:
        left_s = round(self.left_s)
        text = (
            f"{what}, best free run {self._best:.3f}, at most {left_s // 60}:{left_s % 60:02d} left"
        )
        self._bar.set_postfix_str(text)
        now_s = self._now_s()
        if self._bar.disable and now_s - self._told_s >= LINE_S:
            self._told_s = now_s
            print(f"o2train: {text}", file=self._out, flush=True)
