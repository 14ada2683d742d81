"""The progress of long work on the standard error: a bar on a terminal, else lines."""

import math
import sys
import time
from collections.abc import Callable
from threading import Lock
from typing import TYPE_CHECKING, Any, Final, Self, TextIO

from tqdm import tqdm

from training.narx.work import PER_MINUTE

if TYPE_CHECKING:
    from training.narx.search.structure import Try

PARTS: Final = 1000  # of a whole fit
LINE_S: Final = 30.0  # between two lines where there is no terminal


class Progress:
    """A bar, and the clock that says when the next line is due; closed on leaving the context.

    out : where it is shown, default the standard error
    monotonic_s : clock in s
    shape : of the bar, as tqdm takes it
    """

    def __init__(
        self,
        out: TextIO | None = None,
        monotonic_s: Callable[[], float] = time.monotonic,
        **shape: Any,
    ) -> None:
        self._out, self._clock_s = out or sys.stderr, monotonic_s
        self._bar = tqdm(leave=False, disable=None, file=self._out, **shape)
        self._began_s = self._told_s = monotonic_s()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def step(self, text: str) -> None:
        """Show a further step of work whose length nobody knows."""
        self._bar.set_description_str(text)
        self._bar.update()
        self.tell(f"o2train: {text}")

    def tell(self, line: str) -> None:
        """Print a line if there is no terminal and the last line is long enough ago."""
        now_s = self._clock_s()
        if self._bar.disable and now_s - self._told_s >= LINE_S:
            self._told_s = now_s
            print(line, file=self._out, flush=True)


class Share(Progress):
    """A bar over a whole fit, with its best error so far and the time that is left.

    what : what is fitted
    shown : where and by which clock, as in ``Progress``
    """

    unit = "phi"  # of the error

    def __init__(self, what: str, *shown: Any) -> None:
        form = "{desc} {percentage:3.0f} %|{bar}| {remaining} left{postfix}"
        super().__init__(*shown, total=PARTS, desc=what, bar_format=form)
        self._what, self._best = what, math.inf

    def update(self, done: float, error: float = math.inf) -> None:
        """Show the share done, 0 to 1, and an error, of which the least so far is told."""
        done, self._best = min(done, 1.0), min(self._best, error)
        best = f"best error {self._best:.4f} {self.unit}" if math.isfinite(self._best) else ""
        self._bar.set_postfix_str(best, refresh=False)
        self._bar.update(round(PARTS * done) - self._bar.n)
        if round(100 * done):  # before, the pace is not known
            left_s = (self._clock_s() - self._began_s) * (1.0 - done) / done
            told = f"{100 * done:.0f} % done, {left_s:.0f} s left", best
            self.tell(f"{self._what}: {', '.join(filter(None, told))}")


class Budget(Share):
    """Counted work of all trainings side by side; they may end long before their budget.

    minutes : of work
    """

    unit = "standard deviations of the output"

    def __init__(self, minutes: float, *shown: Any) -> None:
        super().__init__("training", *shown)
        self._lock, self._work, self._spent = Lock(), minutes * PER_MINUTE, 0.0

    def tried(self, candidate: "Try") -> None:
        """Take a structure that was tried."""
        with self._lock:
            self.update(self._spent / self._work, candidate.rmse)

    def spend(self, epoch: float) -> None:
        """Take the work of one more epoch."""
        with self._lock:
            self._spent += epoch
            self.update(self._spent / self._work)
