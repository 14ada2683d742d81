"""Logs as blocks of frames: the frames, counters and errors of ``sources.read_frames``."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, Final

from monitor import mdf
from monitor.batch import blf, candump
from monitor.batch.blocks import blocks_of
from monitor.candump import LogCounters
from monitor.sources import checked_kind, guarded, open_binary, read_frames
from monitor.types import FrameBlock

_READERS: Final[dict[str, Callable[[BinaryIO, LogCounters], Iterator[FrameBlock]]]] = {
    ".log": candump.read_blocks,
    ".blf": blf.read_blocks,
    ".mf4": mdf.read_blocks,
}


def read_blocks(path: str | Path, counters: LogCounters | None = None) -> Iterator[FrameBlock]:
    """Return the frames of the log ``path`` in the order of the file, many at a time.

    counters : is kept up to date, block by block
    Raises RecordingError as ``sources.read_frames`` does, after the frames before the damage.
    """
    path = Path(path)
    counters = LogCounters() if counters is None else counters
    kind = checked_kind(path)
    if kind in _READERS:
        return guarded(path, counters, _blocks(path, kind, counters))
    return blocks_of(read_frames(path, counters))


def _blocks(path: Path, kind: str, counters: LogCounters) -> Iterator[FrameBlock]:
    with open_binary(path) as file, mdf.quiet():
        yield from _READERS[kind](file, counters)
