"""Logs as blocks of frames, with the counters and errors of ``logs.read_frames``."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from monitor.base.types import FrameBlock
from monitor.frames import candump_blocks, mdf
from monitor.frames.blf import blocks as blf_blocks
from monitor.frames.blocks import blocks_of
from monitor.frames.bounds import open_binary
from monitor.frames.candump import LogCounters
from monitor.frames.logs import checked_kind, guarded, read_frames

_LARGEST_BLOCK: Final = 31 << 20  # bytes; glibc's threshold grows only up to 32 MB
_KINDS: Final = (".log", ".blf", ".mf4")  # read in blocks; other formats frame by frame


def read_blocks(
    path: str | Path,
    counters: LogCounters | None = None,
) -> Iterator[FrameBlock]:
    """Return the frames of a log in blocks, in the order of the file.

    counters : updated with every block
    Raises RecordingError as ``logs.read_frames`` does, after the frames before the damage.
    """
    path = Path(path)
    counters = LogCounters() if counters is None else counters
    kind = checked_kind(path)
    if kind in _KINDS:
        _keep_freed_memory()
        return guarded(path, counters, _blocks(path, kind, counters))
    return blocks_of(read_frames(path, counters))


def _blocks(path: Path, kind: str, counters: LogCounters) -> Iterator[FrameBlock]:
    with open_binary(path) as file:
        if kind == ".log":
            yield from candump_blocks.read_blocks(file, counters)
        elif kind == ".blf":
            yield from blf_blocks.read_blocks(file, counters)
        else:
            with mdf.quiet():
                yield from mdf.read_blocks(file, counters)


def _keep_freed_memory() -> None:
    """Let glibc keep freed memory for the next chunk, instead of mapping it page by page again.

    Freeing a large mapped block raises the limit up to which glibc keeps memory: mallopt(3),
    M_MMAP_THRESHOLD. The block is never touched. This saves 10 % of the time of candump and BLF.
    """
    np.empty(_LARGEST_BLOCK, dtype=np.uint8)
