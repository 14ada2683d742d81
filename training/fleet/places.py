"""Paths and URLs of recordings: list folders and patterns, fetch remote files (by fsspec)."""

import hashlib
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any, Final

import fsspec

from monitor.base.errors import RecordingError, UsageError

SUFFIXES: Final = (
    *(".log", ".asc", ".blf", ".csv", ".trc", ".mf4", ".mdf", ".dat", ".parquet"),
    *(".mlg", ".msl", ".vbo", ".tsv", ".ascii", ".lvm", ".crtd"),
)
_MAGIC: Final = "*?["
_WEB: Final = ("http://", "https://")


def is_local(url: str) -> bool:
    """Return whether a path or URL is a path in the local file system."""
    return "://" not in url


def find(url: str) -> list[str]:
    """Return the recordings of a file, a folder (with all its subfolders) or a pattern.

    A web address is no pattern, because its ``?`` begins a query. A local path is no pattern if a
    file or folder has exactly this name.
    Raises UsageError if there is no recording or the place cannot be reached.
    """
    local = is_local(url)
    try:
        is_there = url.startswith(_WEB) or (local and Path(url).exists())
        system, path = (fsspec.filesystem("file"), url) if local else fsspec.core.url_to_fs(url)
        if not is_there and any(sign in url for sign in _MAGIC):
            found = [p for p in system.glob(path) if is_recording(p)]
        elif system.isdir(path):
            found = [p for p in system.find(path) if is_recording(p)]
        elif local and not system.exists(path):
            raise UsageError(f"{url}: no such file or folder")
        else:
            return [url]  # a missing remote file gives an error when it is read
    except UsageError:
        raise
    except Exception as error:  # file systems raise whatever their libraries raise
        raise UsageError(f"{url}: {_reason(error)}") from error
    if not found:
        raise UsageError(f"{url}: no recording there; wanted {' '.join(SUFFIXES)}, also with .gz")
    return sorted(_as_written(url, p) if local else system.unstrip_protocol(p) for p in found)


def is_recording(name: str) -> bool:
    """Return whether a file name has the suffix of a log or table, also with .gz."""
    return name.lower().removesuffix(".gz").endswith(SUFFIXES)


def folder_of(url: str) -> str:
    """Return the folder of a recording, a path or URL."""
    return str(Path(url).parent) if is_local(url) else _without_query(url).rpartition("/")[0]


def name_of(url: str) -> str:
    """Return the file name of a recording."""
    return PurePosixPath(_without_query(url)).name


def joined(folder: str, path: str) -> str:
    """Return ``path`` relative to ``folder``; an absolute path or a URL stays."""
    if "://" in path or path.startswith("/"):
        return path
    return str(Path(folder) / path) if is_local(folder) else f"{folder}/{path}"


def read_text(url: str) -> str:
    """Return the content of a text file; bytes that are not UTF-8 become lone surrogates.

    Raises UsageError if the file cannot be read.
    """
    try:
        with fsspec.open(url, "rb") as file:
            content: bytes = file.read()
        return content.decode("utf-8", "surrogateescape")
    except Exception as error:
        raise UsageError(f"{url}: {_reason(error)}") from error


@contextmanager
def fetched(url: str, root: Path | None = None) -> Iterator[Path]:
    """Yield the path of a local file with the recording.

    A remote recording is copied to a temporary file, which is removed at the end of the context.

    root : folder that a relative path refers to; None is the current folder
    Raises RecordingError with the URL if a remote recording cannot be read.
    """
    if is_local(url):
        yield (root or Path()) / url
        return
    with TemporaryDirectory(prefix="o2-fleet-") as folder:
        path = Path(folder) / name_of(url)
        try:
            with fsspec.open(url, "rb") as source, path.open("wb") as copy:
                shutil.copyfileobj(source, copy, 1 << 20)
        except Exception as error:
            raise RecordingError(f"{url}: {_reason(error)}") from error
        yield path


def sha256_of(text: str | bytes) -> str:
    """Return the sha256 of a text (UTF-8) or of bytes as hexadecimal digits."""
    data = text.encode() if isinstance(text, str) else text
    return hashlib.sha256(data).hexdigest()


def _without_query(url: str) -> str:
    return url.partition("?")[0] if url.startswith(_WEB) else url


def _as_written(url: str, absolute: str) -> str:
    """Return a local path relative to the current folder if the user wrote a relative ``url``."""
    if Path(url).is_absolute():
        return absolute
    path = Path(absolute)
    cwd = Path.cwd()
    return str(path.relative_to(cwd)) if path.is_relative_to(cwd) else absolute


def _reason(error: Exception) -> str:
    if isinstance(error, ImportError):
        return f"{error.name or error} is not installed"
    message: Any = getattr(error, "strerror", None) or " ".join(str(error).split())
    return f"cannot be read: {message or type(error).__name__}"
