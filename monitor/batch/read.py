"""Logs as blocks of frames: the frames, counters and errors of ``sources.read_frames``."""

from collections.abc import Iterator
from io import BufferedIOBase
from pathlib import Path
from typing import cast

from monitor.batch import blf, candump
from monitor.batch.blocks import blocks_of
from monitor.candump import LogCounters
from monitor.sources import checked_kind, guarded, open_binary, read_frames
from monitor.types import FrameBlock


def read_blocks(path: str | Path, counters: LogCounters | None = None) -> Iterator[FrameBlock]:
    """Return the frames of the log ``path`` in the order of the file, many at a time.

    counters : is kept up to date, block by block
    Raises RecordingError as ``sources.read_frames`` does, after the frames before the damage.
    """
    path = Path(path)
    counters = LogCounters() if counters is None else counters
    kind = checked_kind(path)
    if kind == ".log":
        return guarded(path, counters, _candump(path, counters))
    if kind == ".blf":
        return guarded(path, counters, _blf(path, counters))
    return blocks_of(read_frames(path, counters))


def _candump(path: Path, counters: LogCounters) -> Iterator[FrameBlock]:
    with open_binary(path) as file:
        yield from candump.read_blocks(cast(BufferedIOBase, file), counters)


def _blf(path: Path, counters: LogCounters) -> Iterator[FrameBlock]:
    with open_binary(path) as file:
        yield from blf.read_blocks(file, counters)
