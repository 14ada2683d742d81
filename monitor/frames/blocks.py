"""Blocks of frames side by side: made from frames, turned back into frames, cut and joined."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from monitor.base.counts import counted
from monitor.base.types import BoolArray, Frame, FrameBlock, IntArray

EXTENDED: Final = 1 << 31  # bit of a block's key: the identifier has 29 bits
FRAMES: Final = 1 << 16  # most frames in a block
MAX_BYTES: Final = 64  # data of a CAN FD frame
FD_LENGTHS: Final = (12, 16, 20, 24, 32, 48, 64)  # bytes of the length codes 9 to 15 of CAN FD
LATEST_S: Final = 9.2e9  # 64 bits of nanoseconds end in the year 2262
DAMAGED_SHARE: Final = 0.01  # of the lines; a log with more of them is another format, or rubbish


class CutShortError(ValueError):
    """The file ends before its contents do: the frames before its end are whole."""


@dataclass(slots=True)
class LogCounters:
    """Counts of the frames in a log, and what is to be told of it."""

    frames: int = 0  # data frames
    skipped: int = 0  # error frames and remote frames
    damaged: int = 0  # lines that are no frame
    is_cut: bool = False  # the log ends too early
    notes: list[str] = field(default_factory=list)  # in words
    _first_damage: str = ""

    def leave_out(self, number: int, line: str, wanted: str) -> None:
        """Count a damaged line; raises ValueError if ``DAMAGED_SHARE`` is exceeded.

        number : of the line in the file
        """
        self.damaged += 1
        told = f"line {number} is {line.strip()[:60]!r}, {wanted}"
        self._first_damage = self._first_damage or told
        if self.damaged > 1 + DAMAGED_SHARE * number:
            raise ValueError(self._first_damage)

    def finish(self, error: Exception | None = None) -> None:
        """Tell what is missing; ``error`` says why the log ends too early, if it does."""
        if self.damaged:
            lines = counted(self.damaged, "line")
            self.notes.append(f"{lines} left out, the first: {self._first_damage}")
        if error is not None:
            self.is_cut = True
            self.notes.append(f"cut short after {self.frames} frames: {error}")


def block_of(frames: list[Frame]) -> FrameBlock:
    """Return the frames as one block; its data is 8 bytes wide, or 64 if a frame is longer."""
    lengths = [len(frame.data) for frame in frames]
    width = 8 if max(lengths, default=0) <= 8 else 64
    data = b"".join([frame.data.ljust(width, b"\0") for frame in frames])
    return FrameBlock(
        np.array([frame.t_ns for frame in frames], dtype=np.int64),
        np.array([f.can_id | f.is_extended * EXTENDED for f in frames], dtype=np.uint32),
        np.array(lengths, dtype=np.uint8),
        np.frombuffer(data, dtype=np.uint8).reshape(len(frames), width),
    )


def frames_of(block: FrameBlock) -> Iterator[Frame]:
    """Yield the frames of a block one by one."""
    new, width, data = tuple.__new__, block.data.shape[1], block.data.tobytes()
    rows = zip(block.t_ns.tolist(), block.key.tolist(), block.length.tolist(), strict=True)
    for row, (t_ns, key, length) in enumerate(rows):
        payload = data[row * width : row * width + length]
        yield new(Frame, (t_ns, key & (EXTENDED - 1), key >= EXTENDED, payload))


def chosen(block: FrameBlock, rows: slice | BoolArray | IntArray) -> FrameBlock:
    """Return some frames of a block."""
    return _by_column(lambda column: column[rows], block)


def joined(blocks: Sequence[FrameBlock]) -> FrameBlock:
    """Return the blocks joined to one, in order."""
    return _by_column(lambda *parts: np.concatenate(parts), *widened(*blocks))


def inserted(block: FrameBlock, places: Sequence[int], new: FrameBlock) -> FrameBlock:
    """Return a block with the frames of ``new`` before the places, one each."""
    return _by_column(lambda a, b: np.insert(a, places, b, axis=0), *widened(block, new))


def put(block: FrameBlock, rows: list[int], new: FrameBlock) -> FrameBlock:
    """Write the frames of ``new`` into ``rows`` of the block; return it, widened if needed."""
    pair = widened(block, new)
    for own, other in zip(*pair, strict=True):
        own[rows] = other
    return pair[0]


def _by_column(make: Callable[..., Any], *blocks: FrameBlock) -> FrameBlock:
    return FrameBlock(*(make(*columns) for columns in zip(*blocks, strict=True)))


def widened(*blocks: FrameBlock, least: int = 0) -> list[FrameBlock]:
    """Return blocks with data as wide as those of the widest, at least ``least`` bytes."""
    width = max(least, *(block.data.shape[1] for block in blocks))
    wider = [(block, width - block.data.shape[1]) for block in blocks]
    return [
        block._replace(data=np.pad(block.data, ((0, 0), (0, more)))) if more else block
        for block, more in wider
    ]
