"""The log format of ``candump -L``: ``(1436509052.249713) vcan0 044#2A366C2BBA``."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from monitor.types import Frame

_ERROR_FLAG = 0x20000000
_REMOTE = ("R", "r")


@dataclass(slots=True)
class LogCounters:
    """What a log held."""

    frames: int = 0  # handed on
    skipped: int = 0  # error frames and remote frames


def read_candump(lines: Iterable[str], counters: LogCounters) -> Iterator[Frame]:
    """Yield the frames; error frames and remote frames are skipped and counted.

    Raises ValueError naming the line if one cannot be understood.
    """
    for number, line in enumerate(lines, 1):
        parts = line.split()
        if not parts:
            continue
        try:
            identifier, mark, data = parts[2].partition("#")
            stamp, can_id = parts[0], int(identifier, 16)
            if not mark or stamp[0] != "(" or stamp[-1] != ")":
                raise ValueError("not a candump line")
            if can_id & _ERROR_FLAG or data[:1] in _REMOTE:
                counters.skipped += 1
                continue
            frame = Frame(
                round(float(stamp[1:-1]) * 1e6) * 1000,
                can_id & 0x1FFFFFFF,
                len(identifier) > 3,
                bytes.fromhex(data if data[:1] != "#" else data[2:]),  # CAN FD: ##, flags, data
            )
        except (ValueError, IndexError, OverflowError) as error:
            raise ValueError(
                f"line {number} is {line.strip()[:60]!r}, '(seconds) channel id#data' is wanted"
            ) from error
        counters.frames += 1
        yield frame
