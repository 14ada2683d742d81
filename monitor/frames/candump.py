"""The log format of ``candump -L``: ``(1436509052.249713) vcan0 044#2A366C2BBA``."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

from monitor.base.types import Frame

CUT_SHORT: Final = "the last line is cut short; remove it to use the rest"
LATEST_S: Final = 9.2e9  # what 64 bits hold as nanoseconds; the year 2261
MAX_BYTES: Final = 64  # of data, CAN FD
ERROR_FLAG: Final = 0x20000000
_REMOTE = ("R", "r")


@dataclass(slots=True)
class LogCounters:
    """What a log held."""

    frames: int = 0  # handed on
    skipped: int = 0  # error frames and remote frames


def read_candump(lines: Iterable[tuple[int, str]], counters: LogCounters) -> Iterator[Frame]:
    """Yield the frames; error frames and remote frames are skipped and counted.

    lines : with their numbers in the file, read no further than needed
    Raises ValueError naming the line if one cannot be understood.
    """
    identifiers: dict[str, tuple[int, bool, bool]] = {}  # as parsed; a bus has few
    new, from_hex = tuple.__new__, bytes.fromhex  # Frame(...) itself takes twice as long
    for number, line in lines:
        parts = line.split()
        if not parts:
            continue
        try:
            identifier, mark, data = parts[2].partition("#")
            stamp = parts[0]
            known = identifiers.get(identifier)
            if known is None:
                known = identifiers[identifier] = _identifier(identifier)
            can_id, is_extended, is_error = known
            if not mark or stamp[0] != "(" or stamp[-1] != ")":
                raise ValueError("not a candump line")
            first = data[:1]
            if is_error or first in _REMOTE:
                counters.skipped += 1
                continue
            seconds = float(stamp[1:-1])
            t_ns = round(seconds * 1e6) * 1000
            payload = from_hex(data if first != "#" else data[2:])  # CAN FD: ##, flags, data
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
    """Return identifier, is_extended and whether it marks an error frame."""
    number = int(text, 16)
    return number & 0x1FFFFFFF, len(text) > 3, bool(number & ERROR_FLAG)
