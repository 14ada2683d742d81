"""The progress of a fit that says which share of it is done."""

import time
from collections.abc import Callable
from typing import Final, TextIO

from training.cli.console.progress import Progress

PARTS: Final = 1000


class Share(Progress):
    """A bar over the whole fit, with its best error so far and the time that is left.

    what : what is fitted
    monotonic_s : clock in s
    """

    def __init__(
        self,
        what: str,
        out: TextIO | None = None,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        form = "{desc} {percentage:3.0f} %|{bar}| {remaining} left{postfix}"
        super().__init__(out, monotonic_s, total=PARTS, desc=what, bar_format=form)
        self._what, self._best = what, float("inf")

    def update(self, done: float, error: float) -> None:
        """Show the share done, 0 to 1, and an error in phi, of which the least so far is told."""
        self._best = error = min(self._best, error)
        self._bar.set_postfix_str(f"best error {error:.4f}", refresh=False)
        self._bar.update(round(PARTS * done) - self._bar.n)
        if done > 0.0:
            left_s = self.elapsed_s * (1.0 - done) / done
            self.tell(
                f"{self._what}: {100 * done:.0f} % done, {left_s:.0f} s left, "
                f"best error {error:.4f}"
            )
