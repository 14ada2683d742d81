"""The signals that end a command on a bus."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Final

_ENDING: Final = (signal.SIGINT, signal.SIGTERM)
_HANG_UP: Final = getattr(signal, "SIGHUP", None)  # where there are terminals that hang up


@contextmanager
def ended_by_signals(stop: Callable[..., None]) -> Iterator[None]:
    """Call ``stop`` on SIGINT, SIGTERM and SIGHUP.

    A hang-up that is ignored, as under nohup, stays ignored. Behind the first hang-up others are
    ignored for good: kernel and shell both send one, and the results are still to be written.
    """
    previous: dict[int, Any] = {number: signal.signal(number, stop) for number in _ENDING}

    def hang_up(number: int, frame: FrameType | None) -> None:
        signal.signal(number, signal.SIG_IGN)
        previous.pop(number, None)
        stop(number, frame)

    if _HANG_UP is not None and signal.getsignal(_HANG_UP) != signal.SIG_IGN:
        previous[_HANG_UP] = signal.signal(_HANG_UP, hang_up)
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
