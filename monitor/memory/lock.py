"""One user at a time works on a fault memory: a lock on a file beside it.

SQLite's locks do not serve: they end when any descriptor of the database is closed, and the
database is replaced when it is repaired. The locked file is never renamed or removed.
"""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from monitor.base.errors import RecordingError


class Lock:
    """The lock of a fault memory, not taken yet."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor: int | None = None

    def take(self) -> None:
        """Take the lock; raises RecordingError if another process has it."""
        beside = self._path.with_name(f"{self._path.name}-lock")
        try:
            descriptor = os.open(beside, os.O_CREAT | os.O_RDWR, 0o644)
        except OSError as error:
            raise RecordingError(
                f"{self._path}: cannot open the fault memory: {beside.name}: {error.strerror}"
            ) from None
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(descriptor)
            raise RecordingError(
                f"{self._path}: the fault memory is in use by a running monitor"
            ) from None
        self._descriptor = descriptor

    @property
    def is_taken(self) -> bool:
        """Return whether this process holds the lock by this object."""
        return self._descriptor is not None

    @contextmanager
    def taken(self) -> Iterator[None]:
        """Hold the lock for a while, or longer if it is taken already; raises RecordingError."""
        if self.is_taken:
            yield
            return
        self.take()
        try:
            yield
        finally:
            self.let_go()

    def let_go(self) -> None:
        """Let go of the lock, if it is taken."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None
