"""The outer structure of Vector's BLF files, to detect a file that was cut short.

python-can reads a BLF up to its end and does not report that the end comes too early.
"""

import struct
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import IO, Final, NamedTuple

from monitor.frames.blocks import CutShortError
from monitor.frames.bounds import PIECE_BYTES, BoundError

_FILE_HEADER: Final = struct.Struct("<4sL8xQ8xL4x8H16x")  # its SYSTEMTIME is that of the start
_OBJECT_HEADER: Final = struct.Struct("<4sHHLL")


class BlfHeader(NamedTuple):
    """What the header of a file says."""

    size: int  # bytes of the header
    file_size: int  # bytes
    n_objects: int  # 0: it does not say
    start_s: float  # Unix time of the recording's begin, 0: it does not say


def header_of(file: IO[bytes]) -> BlfHeader:
    """Return the header of a file, which stands behind it afterwards.

    Raises ValueError if the file is no BLF file, CutShortError if it ends inside its header.
    """
    head = file.read(_FILE_HEADER.size)
    if head[:4] != b"LOGG":
        raise ValueError("not a BLF file")
    if len(head) == _FILE_HEADER.size:
        _, size, file_size, n, year, month, _, day, *clock = _FILE_HEADER.unpack(head)
        hour, minute, second, ms = clock
        n_rest = size - _FILE_HEADER.size
        if not 0 <= n_rest <= PIECE_BYTES:
            raise ValueError(f"a header of {size:,} bytes, 144 are usual")
        try:
            start = datetime(year, month, day, hour, minute, second, ms * 1000, tzinfo=UTC)
            start_s = start.timestamp()
        except ValueError:
            start_s = 0.0
        if len(file.read(n_rest)) == n_rest:
            return BlfHeader(size, file_size, n, start_s)
    raise CutShortError("the file ends inside its header")


def objects(file: IO[bytes], header: BlfHeader) -> Iterator[tuple[int, bytes]]:
    """Yield type and body of each object behind the header.

    Raises CutShortError, behind the objects, if the file ends too early; of a last object that is
    incomplete, its part is yielded. Raises ValueError where no object begins.
    """
    position = header.size
    while start := file.read(_OBJECT_HEADER.size):
        if len(start) < _OBJECT_HEADER.size:
            raise CutShortError(f"the file ends inside a header at byte {position}")
        signature, _, _, size, kind = _OBJECT_HEADER.unpack(start)
        if not any(start):  # taken by the writer, and never filled
            raise CutShortError(f"only zeros from byte {position} on")
        if signature != b"LOBJ" or size < _OBJECT_HEADER.size:
            raise ValueError(f"no log object at byte {position}")
        if size > PIECE_BYTES:
            raise BoundError(
                f"a log object of {size:,} bytes at byte {position}, "
                f"at most {PIECE_BYTES:,} are wanted"
            )
        body = file.read(size - _OBJECT_HEADER.size)
        yield kind, body
        if len(body) < size - _OBJECT_HEADER.size:
            raise CutShortError(f"the log object at byte {position} ends too early")
        position += size + len(file.read(size % 4))  # some writers pad the last object, some not
    if position < header.file_size:
        announced = header.file_size
        raise CutShortError(f"the file has {position} bytes, its header announces {announced}")
    if header.file_size <= header.size < position:
        raise CutShortError("the file was never finished: its header announces no data")
