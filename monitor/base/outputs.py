"""Files to write, looked at before the work: nothing that is read is written over."""

import os
from collections.abc import Iterable
from pathlib import Path

from monitor.base.errors import UsageError


def check(outputs: Iterable[Path | None], inputs: Iterable[Path | None] = ()) -> None:
    """Raise UsageError if an output cannot be written, or is one of the inputs."""
    read = [each for each in inputs if each is not None and each.exists()]
    for path in outputs:
        if path is None:
            continue
        folder = path.absolute().parent
        if not folder.is_dir():
            raise UsageError(f"{path}: the folder does not exist")
        if not os.access(folder, os.W_OK):
            raise UsageError(f"{path}: the folder may not be written to")
        if path.is_dir():
            raise UsageError(f"{path}: is a folder, a file to write is wanted")
        if path.exists() and any(path.samefile(each) for each in read):
            raise UsageError(f"{path}: is read, too; choose another file to write")


def numbered(path: Path, number: int) -> Path:
    """Return a file's name with a number.

    >>> numbered(Path("drive.log.gz"), 2).name
    'drive_2.log.gz'
    """
    stem, dot, suffixes = path.name.partition(".")
    return path.with_name(f"{stem}_{number}{dot}{suffixes}")


def unused(path: Path) -> Path:
    """Return the path, with the first free number if there is a file with something in it."""
    found, number = path, 1
    while found.is_file() and found.stat().st_size > 0:
        number += 1
        found = numbered(path, number)
    return found
