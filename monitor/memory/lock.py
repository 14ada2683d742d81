"""One user at a time works on a fault memory: a lock on an empty file beside it, gone afterwards.

Linux and macOS lock with flock, Windows the file's first byte; elsewhere there is no fault memory.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from importlib import import_module
from pathlib import Path

from monitor.base.errors import RecordingError


class Lock:
    """The lock of a fault memory, not taken yet.

    path : as the user names the memory
    file : of the memory, which need not exist
    """

    def __init__(self, path: Path, file: Path) -> None:
        self._path, self._file = path, Path(f"{file}-lock")
        self._descriptor: int | None = None

    @property
    def is_taken(self) -> bool:
        """Return whether this process holds the lock by this object."""
        return self._descriptor is not None

    def take(self) -> None:
        """Take the lock; raises RecordingError if another process has it."""
        try:
            descriptor = os.open(self._file, os.O_CREAT | os.O_RDWR, 0o644)
        except OSError as error:
            said = f"cannot open the fault memory: {self._file.name}: {error.strerror}"
            raise RecordingError(f"{self._path}: {said}") from None
        try:
            if os.name == "nt":
                msvcrt = import_module("msvcrt")
                msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
            else:
                fcntl = import_module("fcntl")
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (ModuleNotFoundError, OSError) as error:
            os.close(descriptor)
            said = "the fault memory is in use by a running monitor"
            if isinstance(error, ModuleNotFoundError):
                said = "this system has no file locks, so no fault memory can be used"
            raise RecordingError(f"{self._path}: {said}") from None
        with suppress(FileNotFoundError):  # its last owner may have removed it since it was opened
            if os.path.samestat(os.fstat(descriptor), self._file.stat()):
                self._descriptor = descriptor
                return
        os.close(descriptor)
        self.take()

    @contextmanager
    def taken(self) -> Iterator[None]:
        """Hold the lock for a while, or longer if it is taken already; raises RecordingError."""
        is_own = not self.is_taken
        if is_own:
            self.take()
        try:
            yield
        finally:
            if is_own:
                self.let_go()

    def let_go(self) -> None:
        """Let go of the lock, if it is taken, and remove its file where the system allows."""
        if self._descriptor is not None:
            steps = [
                partial(self._file.unlink, missing_ok=True),
                partial(os.close, self._descriptor),
            ]
            self._descriptor = None
            for step in reversed(steps) if os.name == "nt" else steps:
                with suppress(OSError):  # a folder may be read-only; Windows removes no open file
                    step()
