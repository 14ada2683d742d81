"""A text file as chunks of whole lines, in a buffer whose ends may be read over."""

import gzip
from collections.abc import Iterator
from io import BufferedIOBase
from typing import Final

import numpy as np
from numpy.typing import NDArray

from monitor.frames.candump import CUT_SHORT

Bytes = NDArray[np.uint8]

CHUNK_BYTES: Final = 1 << 20  # about what a processor's second cache holds
MARGIN: Final = 256  # before and behind the lines that may be read, whatever they hold
_GZIP_STEP: Final = 8192  # what a text file reads at once, so that damage is noticed as late


def line_chunks(file: BufferedIOBase, chunk_bytes: int = CHUNK_BYTES) -> Iterator[Bytes]:
    """Yield whole lines with ``MARGIN`` bytes before and behind them; the array is used again.

    chunk_bytes : read at once; a longer line is read as a whole
    Each line ends with a newline, whatever line ends the file has. Raises ValueError behind a
    last line that has none, and what reading the file raises behind the whole lines before.
    """
    step = _GZIP_STEP if isinstance(file, gzip.GzipFile) else None
    buffer = bytearray(MARGIN + max(chunk_bytes, step or 1) + MARGIN)
    filled = MARGIN
    ending: Exception | None = None
    while ending is None:
        filled, ending = _fill(file, buffer, filled, step)
        cut = _last_end(buffer, filled)
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
    """Fill the buffer up; return how far it is filled and, if the file ends here, why."""
    end = len(buffer) - MARGIN
    with memoryview(buffer) as view:
        while end - filled >= (step or 1):
            try:
                n = file.readinto1(view[filled : filled + step if step else end])
            except Exception as error:  # gzip raises whatever its parts raise
                return filled, error
            if n == 0:
                return filled, _EndError()
            filled += n
    return filled, None


def _last_end(buffer: bytearray, filled: int) -> int:
    """Return where the last whole line ends; a return at the very end may be half a line end."""
    return (
        buffer.rfind(b"\n", MARGIN, filled) + 1
        or buffer.rfind(b"\r", MARGIN, filled - 1) + 1
        or MARGIN
    )


def _with_newlines(buffer: bytearray, cut: int) -> Bytes:
    """Return the lines up to ``cut`` and what is around them."""
    if buffer.find(b"\r", MARGIN, cut) < 0:
        return np.frombuffer(buffer, dtype=np.uint8, count=cut + MARGIN)
    text = buffer[MARGIN:cut].replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return np.frombuffer(bytes(MARGIN) + text + bytes(MARGIN), dtype=np.uint8)
