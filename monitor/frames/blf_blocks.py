"""Vector's BLF, a megabyte of objects at once.

Gives the frames of python-can's ``BLFReader`` and the errors of ``monitor.frames.logs``. Containers
are inflated and joined; their objects form a chain, each saying where the next one begins, and the
chain's links are the places of the signature that fit to each other.
"""

import zlib
from collections.abc import Iterator
from decimal import Decimal
from typing import IO, Any, BinaryIO, Final, NamedTuple, cast

import can
import numpy as np
from can.io import blf as python_can
from can.util import dlc2len
from numpy.typing import NDArray

from monitor.base.types import BoolArray, FloatArray, FrameBlock, IntArray
from monitor.frames import blf, swar
from monitor.frames.blocks import chosen
from monitor.frames.candump import LATEST_S, LogCounters

Words = NDArray[np.uint32]

CHUNK_BYTES: Final = 1 << 19
_MARGIN: Final = 512  # bytes behind them that may be read
_SIGNATURE: Final = int.from_bytes(b"LOBJ", "little")
_TEN_MICROSECONDS: Final = 1  # flag of an object's time
_BASE_HEADER: Final = python_can.OBJ_HEADER_BASE_STRUCT.size
_EXACT: Final = 1 << 53  # integers up to here are doubles
_LENGTHS: Final = np.array([dlc2len(code) for code in range(256)])  # of CAN FD
_DATA: Final = swar.masks([swar.kept_first(n) for n in range(9)])  # of a frame of n bytes

# what an object is, by its type, and the bytes that must be there behind its header
_OTHER, _SKIPPED, _CLASSIC, _FD, _FD_64 = range(5)
_CLASS: Final = np.zeros(256, dtype=np.uint8)
_NEEDED: Final = np.zeros(256, dtype=np.int64)
for _type, _class, _struct in (
    (python_can.CAN_MESSAGE, _CLASSIC, python_can.CAN_MSG_STRUCT),
    (python_can.CAN_MESSAGE2, _CLASSIC, python_can.CAN_MSG_STRUCT),
    (python_can.CAN_ERROR_EXT, _SKIPPED, python_can.CAN_ERROR_EXT_STRUCT),
    (python_can.CAN_FD_MESSAGE, _FD, python_can.CAN_FD_MSG_STRUCT),
    (python_can.CAN_FD_MESSAGE_64, _FD_64, python_can.CAN_FD_MSG_64_STRUCT),
):
    _CLASS[_type], _NEEDED[_type] = _class, _struct.size
_HEADER: Final = np.array([0, 32, 40])  # bytes, by version; others are passed over


class Contents(NamedTuple):
    """What n objects hold, as far as they hold frames."""

    key: Words  # (n,)
    is_remote: BoolArray  # (n,)
    announced: IntArray  # (n,) bytes
    length: IntArray  # (n,) bytes of data that are there
    data: NDArray[np.uint8]  # (n, 8) or (n, 64)


class Objects(NamedTuple):
    """A run of n objects of the chain, all of which begin at a word."""

    data: NDArray[np.uint8]  # what they lie in
    words: Words  # the same
    at: IntArray  # (n,) the word at which each begins
    body: IntArray  # (n,) the word at which what it holds begins
    kind: NDArray[np.uint8]  # (n,) what it is
    size: IntArray  # (n,) bytes


def read_blocks(
    file: IO[bytes], counters: LogCounters, chunk_bytes: int = CHUNK_BYTES
) -> Iterator[FrameBlock]:
    """Yield the frames of a BLF file.

    chunk_bytes : inflated bytes to be worked on at once
    Raises ValueError if the file is damaged or holds fewer objects than its header announces, and
    what zlib and python-can raise, behind the frames before.
    """
    announced = blf.check(file)
    file.seek(0)
    start_s = can.BLFReader(cast(BinaryIO, file)).start_timestamp
    n_objects, rest = 0, b""
    for chunk in _inflated(file, chunk_bytes):
        raw = b"".join((rest, *chunk, bytes(_MARGIN)))
        position = 0
        while run := _run(raw, position):
            objects, position = run
            n_objects += len(objects.at)
            yield from _blocks(objects, start_s, counters)
        rest = raw[position:-_MARGIN]
    if announced is not None and announced > n_objects:
        raise ValueError(f"its header announces {announced} objects")


def _inflated(file: IO[bytes], chunk_bytes: int) -> Iterator[list[bytes]]:
    """Yield what containers hold; what zlib raises comes behind what came before it."""
    parts: list[bytes] = []
    try:
        for kind, body, _ in blf.objects(file, 0):
            if kind != python_can.LOG_CONTAINER:
                continue
            method, _ = python_can.LOG_CONTAINER_STRUCT.unpack_from(body)
            content = body[python_can.LOG_CONTAINER_STRUCT.size :]
            if method == python_can.ZLIB_DEFLATE:
                content = zlib.decompressobj().decompress(content)
            elif method != python_can.NO_COMPRESSION:
                continue  # python-can passes it over, too
            parts.append(content)
            if sum(map(len, parts)) >= chunk_bytes:
                yield parts
                parts = []
    except Exception:
        yield parts
        raise
    yield parts


def _run(raw: bytes, position: int) -> tuple[Objects, int] | None:
    """Return the run of objects from ``position`` on and where it ends, None if none is whole.

    Raises ValueError if there is no object where one must be.
    """
    end = len(raw) - _MARGIN
    first = raw.find(b"LOBJ", position, position + 8)
    if first < 0:
        if position + 8 > end:
            return None
        raise ValueError("Could not find next object")
    if first + _BASE_HEADER > end:
        return None
    place = first % 4
    words = np.frombuffer(raw, np.uint32, (len(raw) - place) // 4, place)
    at = np.flatnonzero(words[first // 4 :] == _SIGNATURE) + first // 4
    begin = 4 * at + place
    kind = np.minimum(words.take(at + 3), 255)
    version = words.take(at + 1) >> 16
    is_known = (version == 1) | (version == 2)
    header = _HEADER.take(version, mode="clip") * is_known
    size = words.take(at + 2).astype(np.int64)
    # an object ends in the chunk, with its header and all that its type needs
    needed = np.maximum(begin + size, begin + header + _NEEDED.take(kind) * is_known)
    is_whole = np.maximum(needed, begin + _BASE_HEADER) <= end
    behind = begin[1:] - (begin + size)[:-1]  # padding
    if size[0] == 0:
        raise ValueError("an object has no length")
    is_linked = is_whole & (size > 0)
    is_linked[1:] &= (behind >= 0) & (behind <= 4)
    n = len(at) if is_linked.all() else int(np.argmin(is_linked))
    if n == 0:
        return None
    following = int(begin[n - 1] + size[n - 1])
    known = _CLASS.take(kind[:n]) * is_known[:n]
    data = np.frombuffer(raw, dtype=np.uint8, offset=place)
    run = Objects(data, words, at[:n], (at + header // 4)[:n], known, size[:n])
    return run, following


def _blocks(objects: Objects, start_s: float, counters: LogCounters) -> Iterator[FrameBlock]:
    """Yield a run's frames as one block; raises ValueError as ``sources`` does, behind it."""
    times_s = _times_s(objects, start_s)
    is_late = ~(np.abs(times_s) < LATEST_S)
    t_ns = np.rint(np.where(is_late, 0.0, times_s) * 1e6).astype(np.int64) * 1000
    contents = _contents(objects)
    is_data = (objects.kind >= _CLASSIC) & ~contents.is_remote
    block = FrameBlock(t_ns, contents.key, contents.length.astype(np.uint8), contents.data)
    is_wrong = is_data & ((contents.announced != contents.length) | is_late)
    n = int(np.argmax(is_wrong)) if is_wrong.any() else len(t_ns)
    counters.skipped += int(np.count_nonzero((objects.kind[:n] != _OTHER) & ~is_data[:n]))
    if not is_data.all() or n < len(t_ns):
        block = chosen(chosen(block, slice(n)), is_data[:n])
    if block.length.max(initial=0) <= 8:
        block = block._replace(data=np.ascontiguousarray(block.data[:, :8]))
    counters.frames += len(block.t_ns)
    if len(block.t_ns):
        yield block
    if n < len(t_ns):
        announced, length = contents.announced[n], contents.length[n]
        if announced != length:
            raise ValueError(f"a frame of {announced} bytes holds only {length}")
        raise ValueError(f"a frame at {times_s[n]:g} s")


def _times_s(objects: Objects, start_s: float) -> FloatArray:
    """Return the times as python-can gives them: the decimal number to the nearest double."""
    words, at = objects.words, objects.at
    ticks = words.take(at + 7).astype(np.uint64) << np.uint64(32)
    ticks |= words.take(at + 6)
    per_s = np.where(words.take(at + 4) == _TEN_MICROSECONDS, 1e5, 1e9)
    times_s = ticks / per_s  # division rounds to the nearest
    for row in np.flatnonzero(ticks >= _EXACT).tolist():
        times_s[row] = float(Decimal(int(ticks[row])) / int(per_s[row]))
    times_s += start_s
    return times_s


def _contents(objects: Objects) -> Contents:
    words, body = objects.words, objects.body
    head = words.take(body)  # channel of 16 bits, flags, length
    key = words.take(body + 1)
    is_extended = key >> np.uint32(31)
    key &= np.uint32(0x1FFFFFFF)
    key |= is_extended << np.uint32(31)
    is_remote = (head & (python_can.REMOTE_FLAG << 16)) != 0
    announced = (head >> 24).astype(np.int64)
    length = np.minimum(announced, 8)
    data = words.take(body + 3).astype(np.uint64) << np.uint64(32)
    data |= words.take(body + 2)
    data &= _DATA.take(length)
    found = Contents(key, is_remote, announced, length, data.view(np.uint8).reshape(-1, 8))
    if (objects.kind >= _FD).any():
        return _with_fd(objects, found)
    return found


def _with_fd(objects: Objects, found: Contents) -> Contents:
    """Put in what is different in CAN FD."""
    data = np.zeros((len(found.key), 64), dtype=np.uint8)
    data[:, :8] = found.data
    rows = np.flatnonzero(objects.kind == _FD)
    body = objects.body[rows]
    state = objects.words.take(body + 3)  # bits, flags, valid bytes of 8 bits each
    found.announced[rows] = _LENGTHS.take(objects.words.take(body) >> 24)
    found.length[rows] = length = np.minimum(state >> 16 & 0xFF, 64)
    data[rows] = _bytes(objects, body, 20, length)

    rows = np.flatnonzero(objects.kind == _FD_64)
    body = objects.body[rows]
    head = objects.words.take(body)  # channel, length code, valid bytes of 8 bits each
    found.announced[rows] = _LENGTHS.take(head >> 8 & 0xFF)
    found.length[rows] = length = head.astype(np.int64) >> 16 & 0xFF
    found.is_remote[rows] = objects.words.take(body + 3) & 0x10 != 0
    # valid bytes behind the end of the object, or where its extension begins, are zero
    behind = (objects.words.take(body + 8) >> 24).astype(np.int64)
    size = objects.size[rows]
    behind = np.where(behind, np.minimum(behind, size), size)
    header = (objects.words.take(objects.at[rows] + 1) & 0xFFFF).astype(np.int64)
    there = behind - header - python_can.CAN_FD_MSG_64_STRUCT.size
    data[rows] = _bytes(objects, body, 40, np.minimum(length, there))
    return found._replace(data=data)


def _bytes(
    objects: Objects, body: IntArray, offset: int, length: NDArray[np.integer[Any]]
) -> NDArray[np.uint8]:
    """Return up to 64 bytes from ``offset`` in the bodies, zero behind each one's length."""
    data = swar.gathered(objects.data, offset, 4 * body, 64)
    data[np.arange(64) >= length[:, np.newaxis]] = 0
    return data
