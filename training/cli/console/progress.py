"""The progress of long work on the standard error: a bar on a terminal, else lines."""

import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, Final, Self, TextIO

from tqdm import tqdm

LINE_S: Final = 30.0  # between two lines where there is no terminal


class Progress:
    """A bar, and the clock that says when the next line is due; closed on leaving the context.

    out : where it is shown, the standard error if None
    monotonic_s : clock in s
    shape : of the bar, as tqdm takes it
    """

    def __init__(
        self, out: TextIO | None, monotonic_s: Callable[[], float] = time.monotonic, **shape: Any
    ) -> None:
        self._out, self._clock_s = out or sys.stderr, monotonic_s
        self._bar = tqdm(leave=False, disable=None, file=self._out, **shape)
        self._began_s = self._told_s = monotonic_s()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.close()

    @property
    def elapsed_s(self) -> float:
        """Return the time since the beginning in s."""
        return self._clock_s() - self._began_s

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
