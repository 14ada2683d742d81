"""Blocks of frames to lines of a candump log, as python-can writes them.

``(1436509052.249713) vcan0 044#2A366C2BBA R``; 29-bit identifiers have eight digits, CAN FD frames
``##`` and their flags.
"""

from functools import lru_cache

from monitor.base.types import FrameBlock
from monitor.frames.blocks import EXTENDED

_CLASSIC = 8  # bytes of data; longer frames are of CAN FD


def lines_of(block: FrameBlock, channel: str = "") -> bytes:
    """Return the frames' lines on a channel, their times in whole microseconds."""
    digits = block.data.tobytes().hex().upper()
    begins = range(0, len(digits), 2 * block.data.shape[1])
    times = [
        f"{t_us:07d}" if t_us >= 0 else f"{t_us:08d}" for t_us in (block.t_ns // 1000).tolist()
    ]
    rows = zip(times, block.key.tolist(), block.length.tolist(), begins, strict=True)
    lines = [
        f"({time[:-6]}.{time[-6:]}{_name(key, length > _CLASSIC, channel)}"
        f"{digits[begin : begin + 2 * length]} R\n"
        for time, key, length, begin in rows
    ]
    return "".join(lines).encode()


@lru_cache(maxsize=1 << 12)
def _name(key: int, is_fd: bool, channel: str) -> str:
    """Return what stands between the time and the data."""
    can_id = key & (EXTENDED - 1)
    number = f"{can_id:08X}" if key >= EXTENDED else f"{can_id:03X}"
    return f") {channel or 'vcan0'} {number}#{'#0' * is_fd}"
