"""Output files: checked before the work, and replaced in one step at its end.

A file is written under another name beside its place, then renamed. A command that fails or is
killed leaves the old file or none, never half a file.
"""

import mmap
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from monitor.base.errors import UsageError
from monitor.base.files.inputs import other_kind

_PACKAGES: Final = ("monitor", "training", "dbc")
MARK: Final = "o2-monitor"  # pages and tables name their generator, other results a schema of these
_MARKS: Final = tuple(f'"{mark}'.encode() for mark in (MARK, "o2mon.", "o2train.", "o2_monitor."))
_NAME_KEPT: Final = 100  # characters of a name that its temporary file keeps: a name has 255 bytes


def check(outputs: Iterable[Path | None], inputs: Iterable[Path | None] = ()) -> None:
    """Raise UsageError if an output cannot be written, is an input, or is another output, too."""
    read = [path for path in inputs if path is not None]
    written: list[Path] = []
    for path in outputs:
        if path is None:
            continue
        _check_place(path)
        if any(same(path, other) for other in read):
            raise UsageError(f"{path}: is read, too; choose another file to write")
        if any(same(path, other) for other in written):
            raise UsageError(f"{path}: would be written twice; choose two files to write")
        if not is_stream(path):
            written.append(path)


def is_own(path: Path) -> bool:
    """Return whether a file with content carries the mark of a page, table, model or result."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        return any(content.find(mark) >= 0 for mark in _MARKS)


def _check_place(path: Path) -> None:
    folder = path.resolve().parent
    if not folder.is_dir():
        raise UsageError(f"{path}: the folder does not exist")
    if path.is_dir():
        raise UsageError(f"{path}: is a folder, a file to write is wanted")
    if not os.access(folder, os.W_OK) and not is_stream(path):
        raise UsageError(f"{path}: the folder may not be written to")
    if path.exists() and not os.access(path, os.W_OK):
        raise UsageError(f"{path}: may not be written to")


def is_stream(path: Path) -> bool:
    """Return whether the path is a FIFO or device, such as ``/dev/stdout``: written as it is."""
    return path.exists() and other_kind(path.stat().st_mode) is not None


def same(path: Path, other: Path) -> bool:
    """Return whether two paths mean one file, which need not exist, by name or by a link."""
    if path.resolve() == other.resolve():
        return True
    return path.exists() and other.exists() and path.samefile(other)


def is_shipped(path: Path) -> bool:
    """Return whether an existing file belongs to the program: its model, databases, settings."""
    if not path.is_file():
        return False
    place = path.resolve()
    return any(place.is_relative_to(folder) for folder in map(_package, _PACKAGES) if folder)


def _package(name: str) -> Path | None:
    found = find_spec(name)
    return Path(found.origin).resolve().parent if found and found.origin else None


@contextmanager
def replaced(path: str | Path) -> Iterator[Path]:
    """Give a new file beside ``path`` to write; at the end it takes the place of ``path``.

    The new file has the suffixes of ``path``. If the block fails, ``path`` stays as it was. A
    symbolic link stays, the file behind it is replaced. A FIFO or device is given as it is.
    Raises UsageError if the file cannot be written.
    """
    path = Path(path)
    try:
        if is_stream(path):
            yield path
        else:
            place = path.resolve()
            begun = place.with_name(f".begun_{os.getpid()}_{place.name[-_NAME_KEPT:]}")
            try:
                yield begun
                take_place(begun, place)
            finally:
                begun.unlink(missing_ok=True)
    except OSError as error:
        raise UsageError(f"{path}: cannot write it: {error.strerror or error}") from None


def take_place(begun: Path, place: Path) -> None:
    """Rename a file once its content is on the disk: the new name may get there before it."""
    with begun.open("rb+") as file:  # Windows syncs only what may be written
        os.fsync(file.fileno())
    if place.exists():
        shutil.copymode(place, begun)
    begun.replace(place)


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a file in one step; raises UsageError if it cannot be written."""
    with replaced(path) as begun:
        begun.write_bytes(content)


def write_text(path: str | Path, text: str) -> None:
    """Write a UTF-8 text file in one step; raises UsageError if it cannot be written.

    Lone surrogates, which stand for undecodable bytes of file names, become escapes.
    """
    write_bytes(path, text.encode("utf-8", "backslashreplace"))


def numbered(path: Path, number: int) -> Path:
    """Return the path with a number in its file name.

    >>> numbered(Path("drive.log.gz"), 2).name
    'drive_2.log.gz'
    """
    stem, dot, suffixes = path.name.partition(".")
    return path.with_name(f"{stem}_{number}{dot}{suffixes}")


def unused(path: Path) -> Path:
    """Return the path; if that file exists and is not empty, with the first free number."""
    candidate, number = path, 1
    while candidate.is_file() and candidate.stat().st_size > 0:
        number += 1
        candidate = numbered(path, number)
    return candidate
