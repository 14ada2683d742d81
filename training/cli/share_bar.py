"""The progress of a fit that says which share of it is done, on the standard error.

A terminal shows a bar; a file or pipe gets a line now and then. Both tell the best error so far
and the time that is left.
"""

import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import Final, TextIO

from tqdm import tqdm

LINE_S: Final = 30.0  # between two lines where there is no terminal
PARTS: Final = 1000


class Share:
    """A bar over the whole fit.

    what : what is fitted
    monotonic_s : clock in s
    """

    def __init__(
        self,
        what: str,
        out: TextIO | None = None,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._what, self._out, self._now_s = what, out or sys.stderr, monotonic_s
        self._bar = tqdm(
            total=PARTS,
            desc=what,
            leave=False,
            disable=None,
            file=self._out,
            bar_format="{desc} {percentage:3.0f} %|{bar}| {remaining} left{postfix}",
        )
        self._best = float("inf")
        self._began_s = self._told_s = monotonic_s()

    def __enter__(self) -> "Share":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.close()

    def update(self, done: float, error: float) -> None:
        """Show the share done, 0 to 1, and an error in phi, of which the least so far is told."""
        self._best = error = min(self._best, error)
        self._bar.set_postfix_str(f"best error {error:.4f}", refresh=False)
        self._bar.update(round(PARTS * done) - self._bar.n)
        now_s = self._now_s()
        if not self._bar.disable or now_s - self._told_s < LINE_S or done <= 0.0:
            return
        self._told_s = now_s
        left_s = (now_s - self._began_s) * (1.0 - done) / done
        line = f"{self._what}: {100 * done:.0f} % done, {left_s:.0f} s left, best error {error:.4f}"
        print(line, file=self._out, flush=True)
