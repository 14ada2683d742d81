"""The log format of ``candump -L``: ``(1436509052.249713) vcan0 044#2A366C2BBA``."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

from monitor.base.types import Frame

CUT_SHORT: Final = "the last line is cut short; remove it to use the rest"
LATEST_S: Final = 9.2e9  # 64 bits of nanoseconds end in the year 2262
MAX_BYTES: Final = 64  # data of a CAN FD frame
ERROR_FLAG: Final = 0x20000000
_REMOTE = ("R", "r")


@dataclass(slots=True)
class LogCounters:
    """Counts of the frames in a log."""

    frames: int = 0  # data frames
    skipped: int = 0  # error frames and remote frames


def read_candump(lines: Iterable[tuple[int, str]], counters: LogCounters) -> Iterator[Frame]:
    """Yield the data frames; error frames and remote frames are skipped and counted.

    lines : line number in the file, and text
    Raises ValueError with the line's number if a line has another format.
    """
    identifiers: dict[str, tuple[int, bool, bool]] = {}  # parsed once: a bus has few of them
    new, from_hex = tuple.__new__, bytes.fromhex  # calling Frame(...) takes twice as long
    for number, line in lines:
        parts = line.split()
        if not parts:
            continue
        try:
            identifier, mark, data = parts[2].partition("#")
            stamp = parts[0]
            parsed = identifiers.get(identifier)
            if parsed is None:
                parsed = identifiers[identifier] = _identifier(identifier)
            can_id, is_extended, is_error = parsed
            if not mark or stamp[0] != "(" or stamp[-1] != ")":
                raise ValueError("not a candump line")
            first = data[:1]
            if is_error or first in _REMOTE:
                counters.skipped += 1
                continue
            seconds = float(stamp[1:-1])
            t_ns = round(seconds * 1e6) * 1000
            payload = from_hex(data if first != "#" else data[2:])  # CAN FD: ##, flag digit, data
            if not -LATEST_S < seconds < LATEST_S or len(payload) > MAX_BYTES:
                raise ValueError("no CAN frame")
            frame = new(Frame, (t_ns, can_id, is_extended, payload))
        except (ValueError, IndexError, OverflowError) as error:
            raise ValueError(
                f"line {number} is {line.strip()[:60]!r}, '(seconds) channel id#data' is wanted"
            ) from error
        counters.frames += 1
        yield frame


def _identifier(text: str) -> tuple[int, bool, bool]:
    """Return the identifier, whether it has 29 bits, and whether it marks an error frame."""
    number = int(text, 16)
    return number & 0x1FFFFFFF, len(text) > 3, bool(number & ERROR_FLAG)
