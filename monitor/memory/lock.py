"""One user at a time works on a fault memory: a lock on a file beside it.

Whoever holds the lock removes the file at the end. One that was removed while it was being opened
is not the lock: a new one is opened. The memory's own files are locked as well: a hard link gives
them other names, with another lock beside. Each storing replaces them, so an older hard link is a
copy.

Linux and macOS lock with flock, Windows the first byte of the file beside only. Elsewhere there is
no fault memory; everything else works.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
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
    def _beside(self) -> Path:
        return self._files[0].with_name(f"{self._files[0].name}-lock")

    @property
    def is_taken(self) -> bool:
        """Return whether this process holds the lock by this object."""
        return bool(self._descriptors)

    def take(self) -> None:
        """Take the lock; raises RecordingError if another process has it."""
        try:
            self._lock(self._beside)
            while not _is(self._descriptors[0], self._beside):
                os.close(self._descriptors.pop())
                self._lock(self._beside)
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
            descriptor = os.open(file, os.O_CREAT | os.O_RDWR, 0o644)
        except OSError as error:
            said = f"cannot open the fault memory: {file.name}: {error.strerror}"
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
        self._descriptors.append(descriptor)

    def let_go(self, begin: int = 0) -> None:
        """Let go of the lock, if it is taken, or of its files from one on."""
        if begin == 0 and self.is_taken and os.name != "nt":  # Windows removes no open file
            with suppress(OSError):
                self._beside.unlink()
        for descriptor in self._descriptors[begin:]:
            os.close(descriptor)
        del self._descriptors[begin:]


def _is(descriptor: int, file: Path) -> bool:
    """Return whether an open file is the one that stands at a path now."""
    try:
        return os.path.samestat(os.fstat(descriptor), file.stat())
    except FileNotFoundError:
        return False
