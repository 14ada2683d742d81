"""A text file as chunks of whole lines, with readable margins around each chunk."""

from collections.abc import Iterator
from typing import BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from monitor.frames.blocks import CutShortError
from monitor.frames.bounds import LINE_BYTES, PACKED_STEP, TOO_LONG, BoundError, is_on_disk

Bytes = NDArray[np.uint8]

CUT_SHORT: Final = "the last line has no end and is left out"
CHUNK_BYTES: Final = 1 << 20  # about the size of a processor's second cache
MARGIN: Final = 256  # bytes before and after the lines that may be read; their content is open


def line_chunks(file: BinaryIO, chunk_bytes: int = CHUNK_BYTES) -> Iterator[Bytes]:
    """Yield whole lines with ``MARGIN`` bytes before and after them.

    chunk_bytes : bytes per chunk; a longer line gets a longer chunk
    Every line ends with a newline, whatever line end the file has. If the last line has no line
    end, CutShortError is raised behind the others. Read errors are raised after the whole lines,
    and so is BoundError for a line of ``LINE_BYTES`` or more.
    """
    step = 0 if is_on_disk(file) else PACKED_STEP
    text, is_end = bytearray(MARGIN), False
    error: Exception | None = None
    while not (is_end or error):
        end = max(MARGIN + chunk_bytes, len(text) + 1)
        try:
            while len(text) < end and not is_end:
                data = file.read1(step or end - len(text))  # type: ignore[attr-defined]
                text += data
                is_end = not data
        except Exception as raised:  # gzip has no common base for its errors
            error = raised
        ends = [at for mark in (b"\n", b"\r") if (at := text.find(mark)) >= 0]
        if min(ends, default=len(text)) >= MARGIN + LINE_BYTES:
            raise BoundError(TOO_LONG)
        # a final return may be half a line end
        cut = max(text.rfind(b"\n"), text.rfind(b"\r", 0, len(text) - 1)) + 1 or MARGIN
        if is_end and text.endswith(b"\r"):
            cut = len(text)
        if is_end and cut < len(text):
            error = CutShortError(CUT_SHORT)
        rest = text[cut:]
        if cut > MARGIN:
            text[cut:] = bytes(MARGIN)
            if b"\r" in text:
                text = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
            yield np.frombuffer(text, dtype=np.uint8)
        text = bytearray(MARGIN) + rest
    if error:
        raise error
