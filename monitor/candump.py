"""The log format of ``candump -L``: ``(1436509052.249713) vcan0 044#2A366C2BBA``."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from monitor.types import Frame

_ERROR_FLAG = 0x20000000


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
            frame = _frame(parts)
        except (ValueError, IndexError) as error:
            raise ValueError(
                f"line {number} is {line.strip()[:60]!r}, '(seconds) channel id#data' is wanted"
            ) from error
        if frame is None:
            counters.skipped += 1
        else:
            counters.frames += 1
            yield frame


def _frame(parts: list[str]) -> Frame | None:
    """Return the frame of one line, None for an error or remote frame."""
    stamp, _, body = parts[:3]
    if stamp[0] != "(" or stamp[-1] != ")":
        raise ValueError("no time in brackets")
    identifier, mark, data = body.partition("#")
    if not mark:
        raise ValueError("no #")
    can_id = int(identifier, 16)
    if can_id & _ERROR_FLAG or data[:1] in {"R", "r"}:
        return None
    if data[:1] == "#":  # CAN FD: one digit of flags follows
        data = data[2:]
    return Frame(
        round(float(stamp[1:-1]) * 1e6) * 1000,
        can_id & 0x1FFFFFFF,
        len(identifier) > 3,
        bytes.fromhex(data),
    )
