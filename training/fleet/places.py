"""Recordings on any file system of fsspec: found by folder or pattern, fetched as local files."""

import hashlib
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any, Final

import fsspec

from monitor.base.errors import RecordingError, UsageError

SUFFIXES: Final = (".log", ".asc", ".blf", ".csv", ".trc", ".mf4", ".mdf", ".dat", ".parquet")
_MAGIC: Final = "*?["
_WEB: Final = ("http://", "https://")


def is_local(url: str) -> bool:
    """Return whether a path is in this machine's file system."""
    return "://" not in url


def is_pattern(url: str) -> bool:
    """Return whether a path is a pattern; an existing file or a web address is not."""
    if url.startswith(_WEB) or not any(sign in url for sign in _MAGIC):
        return False
    return not (is_local(url) and Path(url).exists())


def find(url: str) -> list[str]:
    """Return the recordings of a file, a folder with its subfolders, or a pattern.

    Raises UsageError if there is no recording or the place cannot be reached.
    """
    try:
        system, path = fsspec.core.url_to_fs(url)
        if is_pattern(url):
            found = [p for p in system.glob(path) if is_recording(p)]
        elif system.isdir(path):
            found = [p for p in system.find(path) if is_recording(p)]
        elif is_local(url) and not system.exists(path):
            raise UsageError(f"{url}: no such file or folder")
        else:
            return [url]  # reading it will show whether it exists
    except UsageError:
        raise
    except Exception as error:  # file systems have no common base for their errors
        raise UsageError(f"{url}: {_reason(error)}") from error
    if not found:
        raise UsageError(f"{url}: no recording there; wanted {' '.join(SUFFIXES)}, also with .gz")
    local = is_local(url)
    return sorted(_as_given(url, path, p) if local else system.unstrip_protocol(p) for p in found)


def is_recording(name: str) -> bool:
    """Return whether a name has the suffix of a log or table."""
    return name.lower().removesuffix(".gz").endswith(SUFFIXES)


def folder_of(url: str) -> str:
    """Return the folder of a recording."""
    return str(Path(url).parent) if is_local(url) else _without_query(url).rpartition("/")[0]


def name_of(url: str) -> str:
    """Return a recording's file name."""
    return PurePosixPath(_without_query(url)).name


def joined(folder: str, path: str) -> str:
    """Return ``path`` relative to a folder; absolute paths and URLs stay."""
    if "://" in path or path.startswith("/"):
        return path
    return str(Path(folder) / path) if is_local(folder) else f"{folder}/{path}"


def read_text(url: str) -> str:
    """Return the content of a text file.

    Raises UsageError if it cannot be read.
    """
    try:
        with fsspec.open(url, "r", encoding="utf-8", newline="") as file:
            return str(file.read())
    except Exception as error:
        raise UsageError(f"{url}: {_reason(error)}") from error


@contextmanager
def fetched(url: str, root: Path | None = None) -> Iterator[Path]:
    """Yield a local file of the recording; a remote one is copied and the copy removed at the end.

    root : folder to which a relative path refers; None is the current one
    Raises RecordingError with the URL if the recording cannot be reached.
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
    """Return the sha256 as hexadecimal digits."""
    data = text.encode() if isinstance(text, str) else text
    return hashlib.sha256(data).hexdigest()


def _without_query(url: str) -> str:
    return url.partition("?")[0] if url.startswith(_WEB) else url


def _as_given(url: str, path: str, found: str) -> str:
    """Return a local path in the form of ``url``: relative if that is relative."""
    if Path(url).is_absolute():
        return found
    rest = Path(found)
    cwd = Path.cwd()
    return str(rest.relative_to(cwd)) if rest.is_relative_to(cwd) else found


def _reason(error: Exception) -> str:
    if isinstance(error, ImportError):
        return f"{error.name or error} is not installed"
    said: Any = getattr(error, "strerror", None) or " ".join(str(error).split())
    return f"cannot be read: {said or type(error).__name__}"
