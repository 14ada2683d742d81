"""Frames from a log file.

Formats: candump ``.log``, Vector ``.asc`` and ``.blf``, PEAK ``.trc``, python-can's ``.csv`` and,
with the extra [mdf], ``.mf4``; any of them may be gzipped (``.log.gz``). Text logs of other tools
are known by their first lines, whatever their suffix. Times are rounded to
microseconds, the resolution of all formats, so a log recorded from a bus replays to the same
bytes.
"""

from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final, TypeVar

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.files.inputs import open_regular
from monitor.base.types import Frame, FrameBlock
from monitor.frames import mdf
from monitor.frames.blf import blocks as blf
from monitor.frames.blocks import LATEST_S, CutShortError, LogCounters, frames_of
from monitor.frames.bounds import open_binary, open_text
from monitor.frames.channels import Channels
from monitor.frames.tables.readers import SUFFIXES as TABLES
from monitor.frames.tables.readers import reason, suffix_of
from monitor.frames.text import candump
from monitor.frames.text.layouts import UNREAD, LayoutFound, frames_of_lines, layout_of
from monitor.frames.text.tools import CANDUMP, LAYOUTS

if TYPE_CHECKING:
    import can

# of the formats that are read in blocks; others are read line by line
_READERS: Final[dict[str, Callable[[BinaryIO, LogCounters, Channels], Iterator[FrameBlock]]]] = {
    ".log": candump.read_blocks,
    ".blf": blf.read_blocks,
    ".mf4": mdf.read_blocks,
}
LOG_SUFFIXES: Final = (".log", ".asc", ".blf", ".csv", ".trc", ".mf4")  # that are written, too
_OTHER_SUFFIXES: Final = (".txt", ".crtd")  # of tools whose layout the first lines tell
_TOOLS: Final = ", ".join(each.tool for each in LAYOUTS)
_LARGEST_BLOCK: Final = 31 << 20  # bytes; glibc's threshold grows only up to 32 MB

T = TypeVar("T")


def read_blocks(
    path: str | Path, counters: LogCounters | None = None, channels: Channels | None = None
) -> Iterator[FrameBlock]:
    """Return the frames of a log in blocks, in the order of the file.

    counters : updated with every block
    channels : which frames to keep; default: all
    A log that ends too early is read as far as it goes, and a few damaged lines are left out: the
    counters tell it. Raises RecordingError with file, reason and number of frames read if the log
    is missing, empty, of unknown format or contradicts itself, after the frames before the damage.
    Errors visible without reading are raised at once.
    """
    path = Path(path)
    counters = LogCounters() if counters is None else counters
    blocks = _blocks(path, checked_kind(path), counters, channels or Channels())
    return guarded(path, counters, blocks)


def read_frames(path: str | Path, counters: LogCounters | None = None) -> Iterator[Frame]:
    """Return the frames of a log one by one; parameters and errors as of ``read_blocks``."""
    return chain.from_iterable(map(frames_of, read_blocks(path, counters)))


def checked_kind(path: Path) -> str:
    """Return the log's format as ``log_kind`` does.

    Raises RecordingError if the format is unknown, or the log is unreadable or empty.
    """
    kind = log_kind(path, (*LOG_SUFFIXES, *_OTHER_SUFFIXES))
    try:
        with open_regular(path) as file:
            is_empty = not file.read(1)
    except OSError as error:
        raise RecordingError(f"{path}: cannot read it: {error.strerror}") from error
    if is_empty:
        raise RecordingError(f"{path}: the log is empty")
    if kind == ".mf4" and not find_spec("asammdf"):
        raise RecordingError(
            f"{path}: reading .mf4 needs asammdf: pip install '.[mdf]' in the project's folder"
        )
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


def log_kind(path: Path, known: Sequence[str] = LOG_SUFFIXES) -> str:
    """Return the format's suffix without .gz; raises RecordingError if it is not known."""
    kind = suffix_of(path)
    for each in UNREAD["binary"]:
        if kind in each["suffixes"]:
            raise RecordingError(
                f"{path}: {each['is']}: not read, convert it with {each['converter']}"
            )
    if kind not in known:
        advice = "give it the ending of what it holds, for frames {}, for a table {} (and .gz)"
        advice = advice.format(*map(" ".join, (known, TABLES)))
        if kind in (*TABLES, ".parquet"):
            advice = "a table; frames are wanted: 'o2train log TABLE --out LOG' writes them"
        raise RecordingError(f"{path}: unknown log format {kind!r}: {advice}")
    return kind


def guarded(path: Path, counters: LogCounters, items: Iterator[T]) -> Iterator[T]:
    """Yield a reader's items, one policy for all: an early end is told, damage is an error.

    Every error of the reader becomes a RecordingError.
    """
    early: Exception | None = None
    try:
        try:
            yield from items
        except (CutShortError, EOFError) as error:
            if not counters.frames:
                raise
            early = error
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from error
    except Exception as error:  # readers have no common base for their errors
        after = f" after {counters.frames} frames" if counters.frames else ""
        raise RecordingError(f"{path}: damaged or cut short{after}: {reason(error)}") from error
    counters.finish(early)
    if counters.frames == 0:
        is_mdf = ".mf4" in path.suffixes
        advice = "; 'o2train table' writes its channels as .csv" if is_mdf else ""
        told = "".join(f"; {note}" for note in counters.notes)
        raise RecordingError(f"{path}: no CAN frames in the log{told}{advice}")


def _blocks(
    path: Path, kind: str, counters: LogCounters, channels: Channels
) -> Iterator[FrameBlock]:
    found = LayoutFound() if kind in (".blf", ".mf4") else layout_of(path, kind)
    is_plain = found.encoding in ("utf-8", "cp1252") and not found.deltas
    if found.layout and not (found.layout is CANDUMP and is_plain):
        with open_text(path, found.encoding, errors="replace") as text:
            yield from channels.blocks_of(frames_of_lines(text, found, counters))
    elif kind in _READERS or found.layout:
        # freeing a large block that was never touched lets glibc keep memory for the next chunk,
        # instead of mapping it page by page: mallopt(3), M_MMAP_THRESHOLD; 10 % of the time
        np.empty(_LARGEST_BLOCK, dtype=np.uint8)
        with open_binary(path) as file:
            yield from _READERS.get(kind, candump.read_blocks)(file, counters, channels)
    else:
        raise ValueError(f"its first lines are those of no CAN log; known are {_TOOLS}")
    channels.finish()
