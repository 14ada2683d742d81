"""One user at a time works on a fault memory: a lock on a file beside it.

SQLite's locks do not serve: they end when any descriptor of the database is closed, and the
database is replaced when it is repaired. The locked file is never renamed or removed. It holds a
note: how often the memory was stored. So an old main file is known as old if the spare copy is
damaged.

Linux and macOS lock with flock, Windows locks one byte behind the note. Elsewhere there is no fault
memory; everything else works.
"""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Final

from monitor.base.errors import RecordingError
from monitor.memory.content import checksum_of

NOTE_BYTES: Final = 200  # most that a note has
LOCKED_BYTE: Final = 1 << 20  # on Windows a locked byte cannot be read, so it is none of the note


class Lock:
    """The lock of a fault memory, not taken yet."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor: int | None = None

    def take(self) -> None:
        """Take the lock; raises RecordingError if another process has it."""
        beside = _beside(self._path)
        try:
            descriptor = os.open(beside, os.O_CREAT | os.O_RDWR, 0o644)
        except OSError as error:
            raise RecordingError(
                f"{self._path}: cannot open the fault memory: {beside.name}: {error.strerror}"
            ) from None
        try:
            _lock(descriptor)
        except ModuleNotFoundError:
            os.close(descriptor)
            raise RecordingError(
                f"{self._path}: this system has no file locks, so no fault memory can be used"
            ) from None
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

    def note(self, memory: str, generation: int) -> None:
        """Note that a memory was stored, if the lock is taken; a disk that is full is no error."""
        if self._descriptor is None:
            return
        text = json.dumps([memory, generation])
        line = f"{checksum_of(text)} {text}".ljust(NOTE_BYTES - 1) + "\n"
        with suppress(OSError):
            os.lseek(self._descriptor, 0, os.SEEK_SET)
            os.write(self._descriptor, line.encode())

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


def noted(path: Path, memory: str) -> int | None:
    """Return how often a memory was stored at least, None if no note of it is there.

    Raises ValueError if the note is damaged.
    """
    try:
        line = _beside(path).read_bytes()[:NOTE_BYTES]
    except OSError:
        return None
    found, text = line.decode().rstrip().split(" ", 1)
    if found != checksum_of(text):
        raise ValueError("the note has changed")
    name, generation = json.loads(text)
    return int(generation) if name == memory else None


def _lock(descriptor: int) -> None:
    """Lock the file for this process.

    Raises OSError if another process has it, ModuleNotFoundError if the system has no locks.
    """
    try:
        fcntl = import_module("fcntl")
    except ModuleNotFoundError:
        msvcrt = import_module("msvcrt")
        os.lseek(descriptor, LOCKED_BYTE, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
    else:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _beside(path: Path) -> Path:
    return path.with_name(f"{path.name}-lock")
