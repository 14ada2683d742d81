"""Checks on output files before the work: they can be written, and overwrite no input."""

import os
from collections.abc import Iterable
from pathlib import Path

from monitor.base.errors import UsageError


def check(outputs: Iterable[Path | None], inputs: Iterable[Path | None] = ()) -> None:
    """Raise UsageError if an output cannot be written, or is one of the inputs."""
    read = [path for path in inputs if path is not None and path.exists()]
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
        if path.exists() and any(path.samefile(other) for other in read):
            raise UsageError(f"{path}: is read, too; choose another file to write")


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
