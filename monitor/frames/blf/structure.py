"""The outer structure of Vector's BLF files, to detect a file that was cut short.

python-can reads a BLF up to its end and does not report that the end comes too early.
"""

import struct
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import IO, Final

from monitor.frames.blocks import CutShortError
from monitor.frames.bounds import PIECE_BYTES, BoundError

_FILE_HEADER: Final = struct.Struct("<4sLBBBBBBBBQQLL")
_START: Final = struct.Struct("<4xL32x8H16x")  # size of the header, its SYSTEMTIME of the start
_OBJECT_HEADER: Final = struct.Struct("<4sHHLL")


def check(file: IO[bytes]) -> tuple[int | None, str]:
    """Return the number of objects that the header announces, and why the file ends too early.

    The number is None if the header announces none, the reason "" if the file is whole. Raises
    ValueError if the file is no BLF file or is damaged.
    """
    head = file.read(_FILE_HEADER.size)
    if len(head) < _FILE_HEADER.size or head[:4] != b"LOGG":
        raise ValueError("not a BLF file")
    fields = _FILE_HEADER.unpack(head)
    header_size, file_size, n_objects = fields[1], fields[10], fields[12]
    n_rest = header_size - _FILE_HEADER.size
    if not 0 <= n_rest <= PIECE_BYTES:
        raise ValueError(f"a header of {header_size:,} bytes, 144 are usual")
    if len(file.read(n_rest)) < n_rest:
        raise CutShortError("the file ends inside its header")
    position = header_size
    try:
        for _, body, n_padding in objects(file, position):
            position += _OBJECT_HEADER.size + len(body) + n_padding
    except (CutShortError, EOFError) as error:
        return n_objects or None, str(error)
    if position < file_size:
        return n_objects, f"the file has {position} bytes, its header announces {file_size}"
    if file_size <= header_size and position > header_size:
        return None, "the file was never finished: its header announces no data"
    return n_objects or None, ""


def start_s(file: IO[bytes]) -> float:
    """Return the Unix time in s at which the recording began, 0 if the header tells no time.

    file : stands at its begin, and behind its header afterwards
    """
    size, year, month, _, day, hour, minute, second, ms = _START.unpack(file.read(_START.size))
    file.read(size - _START.size)
    try:
        return datetime(year, month, day, hour, minute, second, ms * 1000, tzinfo=UTC).timestamp()
    except ValueError:
        return 0.0


def objects(file: IO[bytes], position: int) -> Iterator[tuple[int, bytes, int]]:
    """Yield type, body and number of padding bytes of each object from ``position`` on.

    position : byte at which the file stands
    Of a last object that is incomplete, its part is yielded before CutShortError is raised. Raises
    ValueError where no object begins.
    """
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
        if len(body) < size - _OBJECT_HEADER.size:
            yield kind, body, 0
            raise CutShortError(f"the log object at byte {position} ends too early")
        n_padding = len(file.read(size % 4))  # some writers omit it after the last object
        position += size + n_padding
        yield kind, body, n_padding
