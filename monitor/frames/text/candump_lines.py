"""Blocks of frames to lines of a candump log, as python-can writes them.

``(1436509052.249713) vcan0 044#2A366C2BBA R``; 29-bit identifiers have eight digits, CAN FD frames
``##`` and their flags.
"""

from functools import lru_cache
from itertools import chain, repeat

import numpy as np

from monitor.base.types import FrameBlock
from monitor.frames.blocks import EXTENDED

_CLASSIC = 8  # bytes of data; longer frames are of CAN FD


def lines_of(block: FrameBlock, channel: str = "", end: str = " R") -> bytes:
    """Return the frames' lines on a channel, their times in whole microseconds."""
    digits = block.data.tobytes().hex(" ", block.data.shape[1]).upper().split()
    seconds, rest_us = np.divmod(abs(block.t_ns // 1000), 1_000_000)
    columns = np.where(block.t_ns < 0, "-", ""), seconds, rest_us, 2 * block.length
    *times, n_digits = (column.tolist() for column in columns)
    names = map(_name, block.key.tolist(), (block.length > _CLASSIC).tolist(), repeat(channel))
    values = chain.from_iterable(zip(*times, names, n_digits, digits, strict=True))
    return (f"(%s%d.%06d%s%.*s{end}\n" * len(digits) % tuple(values)).encode()


@lru_cache(maxsize=1 << 12)
def _name(key: int, is_fd: bool, channel: str) -> str:
    """Return what stands between the time and the data."""
    can_id = key & (EXTENDED - 1)
    number = f"{can_id:08X}" if key >= EXTENDED else f"{can_id:03X}"
    return f") {channel or 'vcan0'} {number}#{'#0' * is_fd}"
