"""Results that many tests need: computed once per run, by whichever worker asks first."""

import fcntl
import hashlib
import os
import pickle
import tempfile
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

P, R = ParamSpec("P"), TypeVar("R")
RUN = os.environ.get("PYTEST_XDIST_TESTRUNUID")  # the same in all workers of a run


def folder(run: str) -> Path:
    """Return where the workers of a run keep what they share."""
    return Path(tempfile.gettempdir(), f"o2-monitor-tests-{os.getuid()}-{run}")


def shared(function: Callable[P, R]) -> Callable[P, R]:
    """Return ``function`` with a memory that the workers of a run share through a file.

    The arguments must have a ``repr`` that tells them apart, the result must be picklable. Nobody
    may change the result. Without workers the memory is that of ``functools.cache``.
    """
    if RUN is None:
        return cache(function)

    @cache
    @wraps(function)
    def once(*args: Any, **kwargs: Any) -> Any:
        asked = f"{function.__module__}.{function.__qualname__}{args!r}{kwargs!r}"
        place = folder(RUN or "")
        path = place / hashlib.sha256(asked.encode()).hexdigest()
        place.mkdir(mode=0o700, exist_ok=True)
        with path.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # the other worker waits instead of computing it too
            if not path.exists():
                written = path.with_suffix(".part")
                written.write_bytes(pickle.dumps(function(*args, **kwargs)))
                written.rename(path)
        return pickle.loads(path.read_bytes())

    return once
