"""A text file as chunks of whole lines, with readable margins around each chunk."""

import gzip
from collections.abc import Iterator
from io import BufferedIOBase
from typing import Final

import numpy as np
from numpy.typing import NDArray

from monitor.frames.bounds import LINE_BYTES, too_long
from monitor.frames.candump import CUT_SHORT

Bytes = NDArray[np.uint8]

CHUNK_BYTES: Final = 1 << 20  # about the size of a processor's second cache
MARGIN: Final = 256  # bytes before and after the lines that may be read; their content is open
_GZIP_STEP: Final = 8192  # read size of a text file, so that damage shows after the same line


def line_chunks(file: BufferedIOBase, chunk_bytes: int = CHUNK_BYTES) -> Iterator[Bytes]:
    """Yield whole lines with ``MARGIN`` bytes before and after them; the array is reused.

    chunk_bytes : bytes per chunk; a longer line gets a longer chunk
    Every line ends with a newline, whatever line end the file has. If the last line has no line
    end it is yielded, then ValueError is raised. Read errors are raised after the whole lines, and
    so is BoundError for a line of ``LINE_BYTES`` or more.
    """
    step = _GZIP_STEP if isinstance(file, gzip.GzipFile) else None
    buffer = bytearray(MARGIN + max(chunk_bytes, step or 1) + MARGIN)
    filled = MARGIN
    ending: Exception | None = None
    while ending is None:
        filled, ending = _fill(file, buffer, filled, step)
        cut = _last_end(buffer, filled)
        if _first_length(buffer, filled) >= LINE_BYTES:
            raise too_long()
        if isinstance(ending, _EndError) and cut < filled:
            ending = ValueError(CUT_SHORT)
            buffer[filled : filled + 1] = b"\n"
            cut = filled = filled + 1
        if cut > MARGIN:
            yield _with_newlines(buffer, cut)
        rest = buffer[cut:filled]
        if cut == MARGIN:
            buffer = bytearray(2 * len(buffer))
        filled = MARGIN + len(rest)
        buffer[MARGIN:filled] = rest
    if not isinstance(ending, _EndError):
        raise ending


class _EndError(Exception):
    """The file has been read."""


def _fill(
    file: BufferedIOBase, buffer: bytearray, filled: int, step: int | None
) -> tuple[int, Exception | None]:
    """Fill the buffer; return how far it is filled, and the reason if the file ends here."""
    end = len(buffer) - MARGIN
    with memoryview(buffer) as view:
        while end - filled >= (step or 1):
            try:
                n = file.readinto1(view[filled : filled + step if step else end])
            except Exception as error:  # gzip has no common base for its errors
                return filled, error
            if n == 0:
                return filled, _EndError()
            filled += n
    return filled, None


def _first_length(buffer: bytearray, filled: int) -> int:
    """Return the bytes of the first line; 0 where the buffer is too small for a long line."""
    if filled - MARGIN < LINE_BYTES:
        return 0
    ends = [end for mark in (b"\n", b"\r") if (end := buffer.find(mark, MARGIN, filled)) >= 0]
    return min(ends, default=filled) - MARGIN


def _last_end(buffer: bytearray, filled: int) -> int:
    """Return the end of the last whole line; a final return may be half a line end."""
    return (
        buffer.rfind(b"\n", MARGIN, filled) + 1
        or buffer.rfind(b"\r", MARGIN, filled - 1) + 1
        or MARGIN
    )


def _with_newlines(buffer: bytearray, cut: int) -> Bytes:
    """Return the lines up to ``cut`` with their margins, line ends as newlines."""
    if buffer.find(b"\r", MARGIN, cut) < 0:
        return np.frombuffer(buffer, dtype=np.uint8, count=cut + MARGIN)
    text = buffer[MARGIN:cut].replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return np.frombuffer(bytes(MARGIN) + text + bytes(MARGIN), dtype=np.uint8)
