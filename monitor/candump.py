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
    identifiers: dict[str, tuple[int, bool, bool]] = {}  # as parsed; a bus has few
    new, from_hex = tuple.__new__, bytes.fromhex  # Frame(...) itself takes twice as long
    for number, line in enumerate(lines, 1):
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
            t_ns = round(float(stamp[1:-1]) * 1e6) * 1000
            payload = from_hex(data if first != "#" else data[2:])  # CAN FD: ##, flags, data
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
    return number & 0x1FFFFFFF, len(text) > 3, bool(number & _ERROR_FLAG)
