"""A worker's end: with its coordinator, or by its own death."""

import os
import time
from collections.abc import Iterable
from threading import Thread
from typing import Final

WATCH_S: Final = 1.0  # how often a worker looks whether its coordinator still lives


class WorkerDiedError(Exception):
    """A worker was killed or has crashed while the jobs ``keys`` ran."""

    def __init__(self, keys: Iterable[str]) -> None:
        self.keys = tuple(keys)
        super().__init__(
            f"a worker died while it did {', '.join(self.keys)}: killed, out of memory, or a crash "
            "within a library"
        )


def end_with(parent: int) -> None:
    """End this worker when its coordinator is killed; it would wait for jobs for ever."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_S)
        os._exit(1)

    Thread(target=watch, daemon=True).start()
