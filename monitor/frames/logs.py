"""Frames from a log file.

Formats: candump ``.log``, Vector ``.asc`` and ``.blf``, PEAK ``.trc``, python-can's ``.csv`` and,
with the extra [mdf], ``.mf4``; any of them may be gzipped (``.log.gz``). Times are rounded to
microseconds, the resolution of all formats, so a log recorded from a bus replays to the same
bytes.
"""

from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final, TypeVar

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.files.inputs import open_regular
from monitor.base.types import Frame, FrameBlock
from monitor.frames import mdf
from monitor.frames.blf import blocks as blf
from monitor.frames.blocks import LATEST_S, MAX_BYTES, LogCounters, blocks_of, frames_of
from monitor.frames.bounds import open_binary, open_text
from monitor.frames.tables.readers import SUFFIXES as TABLES
from monitor.frames.text import candump
from monitor.frames.text.frame_lines import FrameLines
from monitor.frames.text.python_can import text_reader

if TYPE_CHECKING:
    import can

# of the formats that are read in blocks; others are read frame by frame by python-can
_READERS: Final[dict[str, Callable[[BinaryIO, LogCounters], Iterator[FrameBlock]]]] = {
    ".log": candump.read_blocks,
    ".blf": blf.read_blocks,
    ".mf4": mdf.read_blocks,
}
LOG_SUFFIXES: Final = (".log", ".asc", ".blf", ".csv", ".trc", ".mf4")
IDENTIFIERS: Final = 1 << 29  # CAN identifiers have 29 bits at most
_LARGEST_BLOCK: Final = 31 << 20  # bytes; glibc's threshold grows only up to 32 MB

T = TypeVar("T")


def read_blocks(path: str | Path, counters: LogCounters | None = None) -> Iterator[FrameBlock]:
    """Return the frames of a log in blocks, in the order of the file.

    counters : updated with every block
    Raises RecordingError with file, reason and number of frames read if the log is missing, empty,
    of unknown format, damaged or cut short, after the frames before the damage. Errors visible
    without reading are raised at once.
    """
    path = Path(path)
    counters = LogCounters() if counters is None else counters
    return guarded(path, counters, _blocks(path, checked_kind(path), counters))


def read_frames(path: str | Path, counters: LogCounters | None = None) -> Iterator[Frame]:
    """Return the frames of a log one by one; errors as of ``read_blocks``."""
    return chain.from_iterable(map(frames_of, read_blocks(path, counters)))


def checked_kind(path: Path) -> str:
    """Return the log's format as ``log_kind`` does.

    Raises RecordingError if the format is unknown, or the log is unreadable or empty.
    """
    kind = log_kind(path)
    try:
        size = path.stat().st_size
        with open_regular(path):
            pass
    except OSError as error:
        raise RecordingError(f"{path}: cannot read it: {error.strerror}") from error
    if size == 0:
        raise RecordingError(f"{path}: the log is empty")
    if kind == ".mf4":
        _require_mdf(path)
    return kind


def frame_of(message: "can.Message") -> Frame:
    """Return a python-can message as a frame, its time rounded to microseconds.

    A time that 64 bits of nanoseconds cannot hold becomes the first or last that they can.
    """
    return Frame(
        round(min(max(message.timestamp, -LATEST_S), LATEST_S) * 1e6) * 1000,
        message.arbitration_id,
        message.is_extended_id,
        bytes(message.data),
    )


def log_kind(path: Path) -> str:
    """Return the format's suffix without .gz; raises RecordingError if it is unknown."""
    suffixes = [suffix.lower() for suffix in path.suffixes]
    is_gzip = bool(suffixes) and suffixes[-1] == ".gz"
    kind = suffixes[-2] if is_gzip and len(suffixes) > 1 else suffixes[-1] if suffixes else ""
    if kind not in LOG_SUFFIXES:
        formats = " ".join(LOG_SUFFIXES)
        raise RecordingError(
            f"{path}: unknown log format {kind!r}, known are {formats} and .gz; "
            f"of tables {' '.join(TABLES)} .parquet"
        )
    return kind


def _require_mdf(path: Path) -> None:
    try:
        import asammdf  # noqa: F401, PLC0415
    except ImportError as error:
        raise RecordingError(
            f"{path}: reading .mf4 needs asammdf: pip install '.[mdf]' in the project's folder"
        ) from error


def guarded(path: Path, counters: LogCounters, items: Iterator[T]) -> Iterator[T]:
    """Yield a reader's items; every error of the reader becomes a RecordingError."""
    try:
        yield from items
    except Exception as error:  # readers have no common base for their errors
        reason = " ".join(str(error).split()) or type(error).__name__
        after = f" after {counters.frames} frames" if counters.frames else ""
        raise RecordingError(f"{path}: damaged or cut short{after}: {reason}") from error
    if counters.frames == 0:
        advice = "; 'o2train table' writes its channels as .csv" if log_kind(path) == ".mf4" else ""
        raise RecordingError(f"{path}: no CAN frames in the log{advice}")


def _blocks(path: Path, kind: str, counters: LogCounters) -> Iterator[FrameBlock]:
    if kind in _READERS:
        _keep_freed_memory()
        with open_binary(path) as file:
            yield from _READERS[kind](file, counters)
        return
    with open_text(path, newline="") as text, text_reader(kind)(FrameLines(text, kind)) as reader:
        yield from blocks_of(through_python_can(reader, counters))


def _keep_freed_memory() -> None:
    """Let glibc keep freed memory for the next chunk, instead of mapping it page by page again.

    Freeing a large mapped block raises the limit up to which glibc keeps memory: mallopt(3),
    M_MMAP_THRESHOLD. The block is never touched. This saves 10 % of the time of candump and BLF.
    """
    np.empty(_LARGEST_BLOCK, dtype=np.uint8)


def through_python_can(reader: Any, counters: LogCounters) -> Iterator[Frame]:
    """Yield the frames that python-can's reader of the format returns.

    Raises ValueError if a frame is impossible, and the reader's errors.
    """
    for message in reader:
        if message.is_error_frame or message.is_remote_frame:
            counters.skipped += 1
            continue
        if len(message.data) != message.dlc:
            raise ValueError(f"a frame of {message.dlc} bytes holds only {len(message.data)}")
        if message.dlc > MAX_BYTES:
            raise ValueError(f"a frame of {message.dlc} bytes, CAN FD has {MAX_BYTES} at most")
        if not 0 <= message.arbitration_id < IDENTIFIERS:
            raise ValueError(
                f"a frame with identifier {message.arbitration_id:#X}, CAN has 29 bits at most"
            )
        if not -LATEST_S < message.timestamp < LATEST_S:
            raise ValueError(f"a frame at {message.timestamp:g} s")
        frame = frame_of(message)
        counters.frames += 1
        yield frame
