"""Bounds for readers of logs and tables: a damaged or hostile file needs little memory and time.

The bounds are on pieces and ratios, never on the whole: a log of any length is read in blocks.

- ``open_binary`` and ``open_text`` open a file, unpacked if its name ends in .gz. They refuse a
  FIFO, a socket and a device. Reading raises ``BoundError`` when a line is longer than
  ``LINE_BYTES`` (text only) or a packed file grows by more than a ratio; other damage of a packed
  file is a ValueError, an OSError or an EOFError.
- ``Inflation`` keeps the same ratio for streams that a format packs itself.

Every reader of a log or table opens its file here, also for python-can's and asammdf's readers.
"""

import gzip
import io
import zlib
from contextlib import suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, BinaryIO, Final, TextIO

from monitor.base.files.inputs import open_regular

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

LINE_BYTES: Final = 1 << 20  # a CAN FD frame takes 200 bytes, a table of 10,000 columns 200,000
TOO_LONG: Final = f"a line of {LINE_BYTES:,} bytes or more, shorter ones are wanted"
RATIO: Final = 100  # of a log; an idle bus whose bytes never change reaches 18
TABLE_RATIO: Final = 400  # 20 columns that never change reach 63, 1,000 blank columns 218
FREE_BYTES: Final = 1 << 20  # this much may come of any packed file, whatever the ratio
PIECE_BYTES: Final = 16 << 20  # of one packed piece; Vector's containers have 128 kB
_STEP: Final = 1 << 16  # bytes that are read at once from a text file
PACKED_STEP: Final = 1 << 13  # of a packed one, so that all before its damage is read


class BoundError(ValueError):
    """A piece of the file is larger than any that a logger writes."""


class Inflation:
    """Keeps the ratio of a packed stream: unpacked bytes by packed bytes."""

    def __init__(self) -> None:
        self._packed = self._unpacked = 0

    def inflate(self, packed: bytes) -> bytes:
        """Return a piece packed by zlib, as far as it goes.

        Raises BoundError if it has more than ``PIECE_BYTES``, or for the ratio; zlib.error.
        """
        unpacker = zlib.decompressobj()
        content = unpacker.decompress(packed, PIECE_BYTES)
        if unpacker.unconsumed_tail:
            raise BoundError(f"a packed piece of more than {PIECE_BYTES:,} bytes")
        self._packed += len(packed)
        self._unpacked += len(content)
        check_ratio(self._packed, self._unpacked)
        return content


def check_ratio(packed: int, unpacked: int, ratio: int = RATIO) -> None:
    """Raise BoundError if so many bytes do not come of a packed log."""
    if unpacked > max(FREE_BYTES, ratio * packed):
        raise BoundError(
            f"{packed:,} bytes of the file grow to more than {unpacked:,}, "
            f"at most {ratio} times as many are wanted"
        )


def open_binary(path: Path) -> BinaryIO:
    """Open the file for reading, unpacked if its name ends in .gz.

    Raises OSError, also for a FIFO, socket or device; reading raises BoundError for the ratio.
    """
    return io.BufferedReader(_KeptFile(path)) if _is_packed(path) else open_regular(path)


def is_on_disk(file: IO[bytes]) -> bool:
    """Return whether a file holds the bytes as they are on the disk, not unpacked."""
    return isinstance(getattr(file, "raw", None), io.FileIO)


def head_of(path: Path, size: int) -> bytes:
    """Return the first bytes of the file; of a packed one that is cut, those before its damage.

    Raises OSError as ``open_binary``.
    """
    head = b""
    with open_binary(path) as file, suppress(EOFError, ValueError):  # the reader tells damage
        while len(head) < size and (piece := file.read1(size - len(head))):  # type: ignore[attr-defined]
            head += piece
    return head


def open_text(
    path: Path, encoding: str = "utf-8", errors: str = "surrogateescape", newline: str | None = None
) -> TextIO:
    """Open the text file for reading line by line, unpacked if its name ends in .gz.

    errors : by default bytes that are not of the encoding become lone surrogates; the parser of
        the line decides on them
    newline : as for ``open``
    Raises what ``open_binary`` does; reading raises BoundError for a line of ``LINE_BYTES``.
    """
    file = io.BufferedReader(_KeptFile(path, has_lines=True), _STEP)
    return io.TextIOWrapper(file, encoding, errors, newline)


def _is_packed(path: Path) -> bool:
    return path.suffix.lower() == ".gz"


class _KeptFile(io.RawIOBase):
    """A file's bytes, unpacked if its name ends in .gz: its ratio is kept, its lines measured."""

    def __init__(self, path: Path, *, has_lines: bool = False) -> None:
        self._file = open_regular(path)
        self._source: Any = gzip.GzipFile(fileobj=self._file) if _is_packed(path) else self._file
        self._step = _STEP if self._source is self._file else PACKED_STEP
        self._has_lines, self._open = has_lines, 0  # bytes of the last line so far

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        while whence == io.SEEK_END and self.read(self._step):  # so that the ratio is seen
            pass
        whence = io.SEEK_CUR if whence == io.SEEK_END else whence
        return int(self._source.seek(offset, whence))

    def readinto(self, buffer: "WriteableBuffer") -> int:
        try:
            data = self._source.read1(min(len(memoryview(buffer)), self._step))
        except zlib.error as error:  # it has no base that readers know
            raise ValueError(f"damaged packed data: {error}") from error
        if self._source is not self._file:
            check_ratio(self._file.tell(), self._source.tell())
        if self._has_lines:
            self._measure(data)
        memoryview(buffer)[: len(data)] = data
        return len(data)

    def _measure(self, data: bytes) -> None:
        ends = [end for mark in (b"\n", b"\r") if (end := data.find(mark)) >= 0]
        if self._open + min(ends, default=len(data)) >= LINE_BYTES:
            raise BoundError(TOO_LONG)
        self._open += len(data)
        if ends:
            self._open = len(data) - 1 - max(data.rfind(b"\n"), data.rfind(b"\r"))

    def close(self) -> None:
        self._source.close()
        self._file.close()
        super().close()
