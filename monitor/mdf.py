"""The block structure of MDF 4 files, to notice one that was cut short.

The libraries that read MDF fail in many ways, some of them silent, on a file that ends too early.
"""

import logging
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, Final

_BLOCK_HEADER: Final = struct.Struct("<4s4xQQ")  # id, length, number of links
_FIRST_BLOCK: Final = 64  # behind the identification


def check(file: IO[bytes]) -> None:
    """Walk all blocks that the header leads to.

    Raises ValueError if this is no finished MDF 4 file, or not a whole one.
    """
    if file.read(8) != b"MDF     ":
        raise ValueError("not an MDF file, or one that was never finished")
    if file.read(1) != b"4":
        raise ValueError("an MDF file of a version before 4")
    size = file.seek(0, 2)
    seen: set[int] = set()
    waiting = [_FIRST_BLOCK]
    while waiting:
        address = waiting.pop()
        if address in seen:
            continue
        seen.add(address)
        file.seek(address)
        head = file.read(_BLOCK_HEADER.size)
        if len(head) < _BLOCK_HEADER.size:
            raise ValueError(f"the file ends before its block at byte {address}")
        name, length, links = _BLOCK_HEADER.unpack(head)
        if name[:2] != b"##" or length < _BLOCK_HEADER.size + 8 * links:
            raise ValueError(f"no MDF block at byte {address}")
        if address + length > size:
            raise ValueError(f"the block at byte {address} ends too early")
        waiting.extend(
            target for (target,) in struct.iter_unpack("<Q", file.read(8 * links)) if target
        )


@contextmanager
def quiet() -> Iterator[None]:
    """Silence asammdf, which prints tracebacks of errors that it raises as well."""
    logger = logging.getLogger("asammdf")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        logger.setLevel(level)
