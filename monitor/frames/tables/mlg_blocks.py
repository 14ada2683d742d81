"""The data blocks of MLG logs: records with their checksums, markers, and damage between them."""

from collections.abc import Iterator
from typing import BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from monitor.base.types import BoolArray
from monitor.frames.tables.raw_table import Notes

BLOCK_HEAD: Final = 4  # type, counter, timestamp
MARKER: Final = BLOCK_HEAD + 50
CHUNK: Final = 4 << 20  # bytes that are read at once


class Blocks:
    """The records of the data, checked, in arrays of whole blocks.

    record : bytes of a record
    """

    def __init__(self, record: int) -> None:
        self._size = BLOCK_HEAD + record + 1

    def of(self, file: BinaryIO, notes: Notes) -> Iterator[NDArray[np.uint8]]:
        """Yield good records, (n, bytes of a block), with type, counter and timestamp.

        Markers, bad records and bytes that belong to no block are left out and counted.
        """
        size, rest, n = self._size, b"", 0
        step = max(CHUNK // size, 4) * size
        while True:
            data = file.read(step)
            chunk = np.frombuffer(rest + data, dtype=np.uint8)
            at = 0
            for begin, end, is_good in self._runs(chunk, notes, ended=not data):
                at = end
                if is_good:
                    n += (end - begin) // size
                    yield chunk[begin:end].reshape(-1, size)
            rest = chunk[at:].tobytes()
            if not data:
                break
        if rest:
            notes.sentences.append(f"cut short after {n} records: {len(rest)} bytes are left")

    def _runs(
        self, chunk: NDArray[np.uint8], notes: Notes, *, ended: bool
    ) -> Iterator[tuple[int, int, bool]]:
        """Yield spans [begin, end): good records in a row, and bytes that are passed over.

        ended : the chunk is the file's last
        """
        size, at, n = self._size, 0, len(chunk)
        good: BoolArray | None = None
        while n - at >= size or (n - at >= MARKER and chunk[at] == 1):
            count = self._good_in_a_row(chunk[at : at + (n - at) // size * size])
            if count:
                yield at, at + count * size, True
                at += count * size
                continue
            if chunk[at] == 1 and n - at >= MARKER:
                notes.count("markers")
                yield at, at + MARKER, False
                at += MARKER
                continue
            if good is None:
                good = self._good_places(chunk)
            following = np.flatnonzero(good[at + 1 :])
            if following.size:
                to = at + 1 + int(following[0])
            elif ended or n - at > 8 * size:  # nothing readable: keep what may begin a record
                to = max(n - size + 1, at + 1) if not ended else n
            else:
                return
            if to - at == size:
                notes.count("bad_checksum")
            else:
                notes.count("damaged_bytes", to - at)
            yield at, to, False
            at = to

    def _good_in_a_row(self, data: NDArray[np.uint8]) -> int:
        """Return how many blocks at the start are records whose checksum is right."""
        blocks = data.reshape(-1, self._size)
        good = (blocks[:, 0] == 0) & (
            np.add.reduce(blocks[:, BLOCK_HEAD:-1], axis=1, dtype=np.uint8) == blocks[:, -1]
        )
        return len(good) if good.all() else int(good.argmin())

    def _good_places(self, chunk: NDArray[np.uint8]) -> BoolArray:
        """Return (n,) bool: here begins a good record, and a marker or the next record after it."""
        size = self._size
        good = np.zeros(len(chunk), dtype=bool)
        if len(chunk) < size:
            return good
        sums = np.cumsum(chunk, dtype=np.uint8)
        starts = np.arange(len(chunk) - size + 1)
        own = sums[starts + size - 2] - sums[starts + BLOCK_HEAD - 1]
        good[starts] = (chunk[starts] == 0) & (own == chunk[starts + size - 1])
        good[starts] &= chunk[starts + size - 1] != 0  # zeros alone look like records
        after = starts[: max(len(chunk) - size - 1, 0)]
        counted = chunk[after + size + 1] == chunk[after + 1] + np.uint8(1)
        good[after] &= counted & (chunk[after + size] <= 1)
        return good
