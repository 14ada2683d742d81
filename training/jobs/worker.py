"""One job on a worker, and the error for a worker that has died."""

import os
import pickle
import time
from collections.abc import Iterable
from functools import lru_cache
from threading import Thread
from typing import Any, Final

from threadpoolctl import threadpool_limits

WATCH_S: Final = 1.0  # how often a worker looks whether its coordinator still lives


class WorkerDiedError(Exception):
    """A worker was killed or has crashed while the jobs ``keys`` ran."""

    def __init__(self, keys: Iterable[str]) -> None:
        self.keys = tuple(keys)
        super().__init__(
            f"a worker died while it did {', '.join(self.keys)}: killed, out of memory, or a crash "
            "within a library"
        )


def of_bytes(shared: bytes, job: bytes) -> bytes:
    """Return the pickled result of a pickled job."""
    function, item = pickle.loads(job)
    with threadpool_limits(1):
        return pickle.dumps(function(_unpickled(shared), item))


@lru_cache(maxsize=1)  # a model is loaded once and not for every job
def _unpickled(shared: bytes) -> Any:
    return pickle.loads(shared)


def end_with(parent: int) -> None:
    """End this worker when its coordinator is killed; it would wait for jobs for ever."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_S)
        os._exit(1)

    Thread(target=watch, daemon=True).start()
