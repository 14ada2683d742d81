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
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, BinaryIO, Final, TextIO, cast

from monitor.base.files.inputs import open_regular

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

LINE_BYTES: Final = 1 << 20  # a CAN FD frame takes 200 bytes, a table of 10,000 columns 200,000
RATIO: Final = 100  # of a log; an idle bus whose bytes never change reaches 18
TABLE_RATIO: Final = 400  # 20 columns that never change reach 63, 1,000 blank columns 218
FREE_BYTES: Final = 1 << 20  # this much may come of any packed file, whatever the ratio
PIECE_BYTES: Final = 16 << 20  # of one packed piece; Vector's containers have 128 kB
_HEAD_STEP: Final = 1 << 10  # so that all before the damage of a packed file is read
_STEP: Final = 1 << 16  # bytes that are read at once from a text file


class BoundError(ValueError):
    """A piece of the file is larger than any that a logger writes."""


class Inflation:
    """Keeps the ratio of a packed stream: unpacked bytes by packed bytes."""

    def __init__(self) -> None:
        self._packed = self._unpacked = 0

    def add(self, packed: int, unpacked: int) -> None:
        """Count bytes; raises BoundError if the stream grows by more than ``RATIO``."""
        self._packed += packed
        self._unpacked += unpacked
        check_ratio(self._packed, self._unpacked)

    def inflate(self, packed: bytes, most_bytes: int = PIECE_BYTES) -> bytes:
        """Return a piece packed by zlib, as far as it goes.

        Raises BoundError if it has more than ``most_bytes``, or for the ratio; zlib.error.
        """
        unpacker = zlib.decompressobj()
        content = unpacker.decompress(packed, most_bytes)
        if unpacker.unconsumed_tail:
            raise BoundError(f"a packed piece of more than {most_bytes:,} bytes")
        self.add(len(packed), len(content))
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
    file = open_regular(path)
    return cast(BinaryIO, _Inflated(file)) if _is_packed(path) else file


def head_of(path: Path, size: int) -> bytes:
    """Return the first bytes of the file; of a packed one that is cut, those before its damage.

    Raises OSError as ``open_binary``.
    """
    head = b""
    with open_binary(path) as file, suppress(EOFError, ValueError):  # the reader tells damage
        while len(head) < size and (piece := file.read(min(_HEAD_STEP, size - len(head)))):
            head += piece
    return head


def open_text(
    path: Path,
    encoding: str = "utf-8",
    errors: str = "surrogateescape",
    newline: str | None = None,
    ratio: int = RATIO,
) -> TextIO:
    """Open the text file for reading line by line, unpacked if its name ends in .gz.

    errors : by default bytes that are not of the encoding become lone surrogates; the parser of
        the line decides on them
    newline : as for ``open``
    ratio : most unpacked bytes by packed bytes
    Raises what ``open_binary`` does; reading raises BoundError for a line of ``LINE_BYTES``.
    """
    if _is_packed(path):
        binary: IO[bytes] = cast(IO[bytes], _InflatedLines(open_regular(path), ratio))
    else:
        binary = io.BufferedReader(_Lines(open_regular(path)), _STEP)
    return io.TextIOWrapper(binary, encoding, errors, newline)


def _is_packed(path: Path) -> bool:
    return path.suffix.lower() == ".gz"


class _Meter:
    """Measures the lines of a stream of bytes."""

    def __init__(self) -> None:
        self._open = 0  # bytes of the last line so far

    def take(self, data: bytes) -> None:
        """Measure the next bytes; raises BoundError if a line is too long."""
        ends = [end for mark in (b"\n", b"\r") if (end := data.find(mark)) >= 0]
        if self._open + min(ends, default=len(data)) >= LINE_BYTES:
            raise too_long()
        if ends:
            self._open = len(data) - 1 - max(data.rfind(b"\n"), data.rfind(b"\r"))
        else:
            self._open += len(data)


def too_long() -> BoundError:
    """Return the error of a line of ``LINE_BYTES`` or more."""
    return BoundError(f"a line of {LINE_BYTES:,} bytes or more, shorter ones are wanted")


class _Lines(io.RawIOBase):
    """A file whose lines are measured."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._meter = file, _Meter()

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: "WriteableBuffer") -> int:
        data = self._file.read(min(len(memoryview(buffer)), _STEP))
        self._meter.take(data)
        memoryview(buffer)[: len(data)] = data
        return len(data)

    def close(self) -> None:
        self._file.close()
        super().close()


@contextmanager
def _told_as_damage() -> Iterator[None]:
    """Raise zlib's error, which has no base that readers know, as ValueError."""
    try:
        yield
    except zlib.error as error:
        raise ValueError(f"damaged packed data: {error}") from error


class _Inflated(gzip.GzipFile):
    """A gzipped file whose ratio is kept."""

    def __init__(self, file: BinaryIO, ratio: int = RATIO) -> None:
        super().__init__(fileobj=file, mode="rb")
        self._source, self._ratio = file, ratio

    def read(self, size: int | None = -1) -> bytes:
        if size is None or size < 0:  # piece by piece, so that the ratio is seen in time
            return b"".join(iter(lambda: self.read(_STEP), b""))
        with _told_as_damage():
            return self._kept(super().read(size))

    def read1(self, size: int = -1) -> bytes:
        with _told_as_damage():
            return self._kept(super().read1(size))

    def readline(self, size: int | None = -1) -> bytes:
        most = LINE_BYTES if size is None or size < 0 else size
        with _told_as_damage():
            return self._kept(super().readline(most))

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        if whence == io.SEEK_END and offset == 0:
            while self.read(_STEP):
                pass
            return self.tell()
        return super().seek(offset, whence)

    def close(self) -> None:
        super().close()
        self._source.close()

    def _kept(self, data: bytes) -> bytes:
        check_ratio(self._source.tell(), self.tell(), self._ratio)
        return data


class _InflatedLines(_Inflated):
    """A gzipped text file whose lines are measured, too."""

    def __init__(self, file: BinaryIO, ratio: int) -> None:
        super().__init__(file, ratio)
        self._meter = _Meter()

    def read1(self, size: int = -1) -> bytes:
        data = super().read1(size)
        self._meter.take(data)
        return data
