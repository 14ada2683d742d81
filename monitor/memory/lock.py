"""One user at a time works on a fault memory: a lock on a file beside it.

The locked file is never renamed or removed. The memory's own files are locked as well: a hard link
gives them other names, with another lock beside. Each storing replaces them, so an older hard link
is a copy.

Linux and macOS lock with flock, Windows the first byte of the file beside only. Elsewhere there is
no fault memory; everything else works.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

from monitor.base.errors import RecordingError


class Lock:
    """The lock of a fault memory, not taken yet.

    path : as the user names the memory
    files : of the memory, which need not exist
    """

    def __init__(self, path: Path, files: Sequence[Path]) -> None:
        self._path, self._files = path, files
        self._descriptors: list[int] = []  # of the file beside, then of the memory's files

    @property
    def is_taken(self) -> bool:
        """Return whether this process holds the lock by this object."""
        return bool(self._descriptors)

    def take(self) -> None:
        """Take the lock; raises RecordingError if another process has it."""
        main = self._files[0]
        try:
            self._lock(main.with_name(f"{main.name}-lock"))
            self.follow()
        except BaseException:
            self.let_go()
            raise

    def follow(self) -> None:
        """Lock the memory's files that are there now; raises RecordingError."""
        self.let_go(1)
        if os.name != "nt":  # Windows replaces no open file
            for file in self._files:
                if file.exists():
                    self._lock(file)

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

    def _lock(self, file: Path) -> None:
        """Lock a file for this process; raises RecordingError."""
        try:
            self._descriptors.append(os.open(file, os.O_CREAT | os.O_RDWR, 0o644))
        except OSError as error:
            said = f"cannot open the fault memory: {file.name}: {error.strerror}"
            raise RecordingError(f"{self._path}: {said}") from None
        try:
            if os.name == "nt":
                msvcrt = import_module("msvcrt")
                msvcrt.locking(self._descriptors[-1], msvcrt.LK_NBLCK, 1)
            else:
                fcntl = import_module("fcntl")
                fcntl.flock(self._descriptors[-1], fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (ModuleNotFoundError, OSError) as error:
            said = "the fault memory is in use by a running monitor"
            if isinstance(error, ModuleNotFoundError):
                said = "this system has no file locks, so no fault memory can be used"
            raise RecordingError(f"{self._path}: {said}") from None

    def let_go(self, begin: int = 0) -> None:
        """Let go of the lock, if it is taken, or of its files from one on."""
        for descriptor in self._descriptors[begin:]:
            os.close(descriptor)
        del self._descriptors[begin:]
