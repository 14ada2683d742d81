"""Vector's BLF files, read in blocks of about half a megabyte of objects.

The frames are those of python-can's ``BLFReader``, the errors those of ``monitor.frames.logs``.
A CAN FD object may hold fewer bytes of data than it announces: the rest is zero, as Vector's tools
read it (python-can's issue 1905). An object whose headers place its data outside of it is damage,
an error as every frame that contradicts itself; python-can takes bytes of the next object.
Containers are inflated and joined. Their objects form a chain, because each object's length gives
the start of the next one. The reader finds all signatures at once and keeps those on the chain.
"""

import struct
from collections import Counter
from collections.abc import Iterator
from decimal import Decimal
from typing import IO, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from monitor.base.types import BoolArray, FloatArray, FrameBlock, IntArray
from monitor.frames.blf import structure
from monitor.frames.blocks import EXTENDED, FD_LENGTHS, LATEST_S, CutShortError, LogCounters, chosen
from monitor.frames.bounds import BoundError, Inflation
from monitor.frames.channels import Channels
from monitor.frames.digits import first_bytes, gathered

Words = NDArray[np.uint32]

CHUNK_BYTES: Final = 1 << 19
_MARGIN: Final = 512  # bytes after a chunk that may be read
_SIGNATURE: Final = int.from_bytes(b"LOBJ", "little")
_TEN_MICROSECONDS: Final = 1  # flag of an object: its time counts in units of 10 us
_OBJECT_BYTES: Final = 16 << 20  # most of one object in a container; a CAN frame takes 150
_BASE_HEADER: Final = 16  # bytes of an object before its version's own header
_FD_64_BYTES: Final = 40  # of an FD object of type 101 before its data
_CONTAINER: Final = 10  # type of the object that holds the others
_CONTAINER_HEADER: Final = struct.Struct("<H14x")  # method of compression
_STORED, _DEFLATED = 0, 2
_REMOTE: Final = 0x80  # flag of a classic frame
_EXACT: Final = 1 << 53  # a double holds every integer up to this one
_LENGTHS: Final = np.array([*range(9), *FD_LENGTHS, *[64] * 240])  # bytes by CAN FD's length code

# Class of an object by its type, and the bytes needed after its header.
_OTHER, _SKIPPED, _CLASSIC, _FD, _FD_64 = range(5)
_CLASS: Final = np.zeros(256, dtype=np.uint8)
_NEEDED: Final = np.zeros(256, dtype=np.int64)
_CLASS[[1, 86, 73, 100, 101]] = _CLASSIC, _CLASSIC, _SKIPPED, _FD, _FD_64
_NEEDED[[1, 86, 73, 100, 101]] = 16, 16, 32, 84, _FD_64_BYTES
_HEADER: Final = np.array([0, 32, 40])  # bytes by header version; other versions are skipped


class Contents(NamedTuple):
    """The fields of n objects; valid where the object is a frame."""

    key: Words  # (n,)
    is_remote: BoolArray  # (n,)
    announced: IntArray  # (n,) bytes of data by the length code
    length: IntArray  # (n,) bytes of data in the object
    is_outside: BoolArray  # (n,) the headers place data outside of the object
    data: NDArray[np.uint8]  # (n, 8) or (n, 64)
    channel: IntArray  # (n,)


class Objects(NamedTuple):
    """A run of n objects on the chain; all begin at a 32-bit word."""

    data: NDArray[np.uint8]  # bytes that contain the objects
    words: Words  # the same bytes as 32-bit words
    at: IntArray  # (n,) word at which the object begins
    body: IntArray  # (n,) word at which the object's body begins
    kind: NDArray[np.uint8]  # (n,) class: _OTHER, _SKIPPED, _CLASSIC, _FD or _FD_64
    size: IntArray  # (n,) bytes
    unknown: IntArray  # (k,) header versions of the frames that cannot be read


def read_blocks(
    file: IO[bytes],
    counters: LogCounters,
    channels: Channels | None = None,
    chunk_bytes: int = CHUNK_BYTES,
) -> Iterator[FrameBlock]:
    """Yield the frames of a BLF file.

    chunk_bytes : inflated bytes per chunk
    Raises CutShortError if the file was never finished or holds fewer objects than its header
    announces, ValueError if it is damaged, and the errors of zlib. The frames before the damage
    are yielded first. Frames in objects of an unknown version are told in the counters' notes.
    """
    header = structure.header_of(file)
    n_objects, rest, unknown = 0, b"", Counter[int]()
    channels = channels or Channels()
    try:
        for chunk in _inflated(file, header, chunk_bytes):
            raw = b"".join((rest, *chunk, bytes(_MARGIN)))
            position = 0
            while run := _run(raw, position):
                objects, position = run
                n_objects += len(objects.at)
                unknown.update(objects.unknown.tolist())
                yield from _blocks(objects, header.start_s, counters, channels)
            rest = raw[position:-_MARGIN]
    finally:
        for version, n in unknown.items():
            counters.notes.append(f"{n} objects of header version {version} are not read")
    if header.n_objects > n_objects:
        raise CutShortError(f"its header announces {header.n_objects} objects")


def _inflated(
    file: IO[bytes], header: structure.BlfHeader, chunk_bytes: int
) -> Iterator[list[bytes]]:
    """Yield the contents of containers in chunks; an error is raised after them."""
    parts: list[bytes] = []
    inflation = Inflation()
    try:
        for kind, body in structure.objects(file, header):
            if kind != _CONTAINER:
                continue
            (method,) = _CONTAINER_HEADER.unpack_from(body)
            content = body[_CONTAINER_HEADER.size :]
            if method == _DEFLATED:
                content = inflation.inflate(content)
            elif method != _STORED:
                continue  # python-can skips it, too
            parts.append(content)
            if sum(map(len, parts)) >= chunk_bytes:
                yield parts
                parts = []
    except Exception:
        yield parts
        raise
    yield parts


def _run(raw: bytes, position: int) -> tuple[Objects, int] | None:
    """Return the run of objects from ``position`` on and its end; None if no object is complete.

    Raises ValueError if an object must begin there and does not.
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
    is_supported = (version == 1) | (version == 2)
    header = _HEADER.take(version, mode="clip") * is_supported
    size = words.take(at + 2).astype(np.int64)
    # an object is whole if the chunk holds its header and the struct of its type
    needed = np.maximum(begin + size, begin + header + _NEEDED.take(kind) * is_supported)
    is_whole = np.maximum(needed, begin + _BASE_HEADER) <= end
    behind = begin[1:] - (begin + size)[:-1]  # bytes of padding
    if size[0] == 0:
        raise ValueError("an object has no length")
    if size[0] > _OBJECT_BYTES:
        raise BoundError(f"an object of {size[0]:,} bytes, at most {_OBJECT_BYTES:,} are wanted")
    is_linked = is_whole & (size > 0)
    is_linked[1:] &= (behind >= 0) & (behind <= 4)
    n = len(at) if is_linked.all() else int(np.argmin(is_linked))
    if n == 0:
        return None
    following = int(begin[n - 1] + size[n - 1])
    classes = _CLASS.take(kind[:n]) * is_supported[:n]
    data = np.frombuffer(raw, dtype=np.uint8, offset=place)
    is_unknown = ~is_supported[:n] & (_CLASS.take(kind[:n]) >= _CLASSIC)
    run = Objects(
        data=data,
        words=words,
        at=at[:n],
        body=(at + header // 4)[:n],
        kind=classes,
        size=size[:n],
        unknown=version[:n][is_unknown].astype(np.int64),
    )
    return run, following


def _blocks(
    objects: Objects, start_s: float, counters: LogCounters, channels: Channels
) -> Iterator[FrameBlock]:
    """Yield a run's frames as one block, then raise ValueError if a frame is damaged."""
    times_s = _times_s(objects, start_s)
    is_late = ~(np.abs(times_s) < LATEST_S)
    t_ns = np.rint(np.where(is_late, 0.0, times_s) * 1e6).astype(np.int64) * 1000
    contents = _contents(objects)
    is_data = (objects.kind >= _CLASSIC) & ~contents.is_remote
    block = FrameBlock(t_ns, contents.key, contents.length.astype(np.uint8), contents.data)
    is_wrong = (contents.announced != contents.length) | is_late | contents.is_outside
    is_wrong &= is_data
    n = int(np.argmax(is_wrong)) if is_wrong.any() else len(t_ns)
    counters.skipped += int(np.count_nonzero((objects.kind[:n] != _OTHER) & ~is_data[:n]))
    channel = contents.channel
    if not is_data.all() or n < len(t_ns):
        block = chosen(chosen(block, slice(n)), is_data[:n])
        channel = channel[:n][is_data[:n]]
    if block.length.max(initial=0) <= 8:
        block = block._replace(data=np.ascontiguousarray(block.data[:, :8]))
    counters.frames += len(block.t_ns)
    if len(block.t_ns):
        yield channels.keep_numbered(block, channel)
    if n < len(t_ns):
        announced, length = contents.announced[n], contents.length[n]
        if contents.is_outside[n]:
            raise ValueError(f"the data of a frame of {length} bytes lie outside of its object")
        if announced != length:
            raise ValueError(f"a frame of {announced} bytes holds only {length}")
        raise ValueError(f"a frame at {times_s[n]:g} s")


def _times_s(objects: Objects, start_s: float) -> FloatArray:
    """Return the times in s as python-can computes them: the nearest double of the decimal."""
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
    head = words.take(body)  # 16 bits of channel, 8 of flags, 8 of length
    key = words.take(body + 1) & np.uint32(EXTENDED | 0x1FFFFFFF)
    is_remote = (head & (_REMOTE << 16)) != 0
    announced = np.minimum(head >> 24, 8).astype(np.int64)  # codes above 8 mean 8, ISO 11898-1
    length = announced.copy()
    data = words.take(body + 3).astype(np.uint64) << np.uint64(32)
    data |= words.take(body + 2)
    data = first_bytes(data, length)
    contents = Contents(
        key=key,
        is_remote=is_remote,
        announced=announced,
        length=length,
        is_outside=np.zeros(len(key), dtype=np.bool_),
        data=data.view(np.uint8).reshape(-1, 8),
        channel=(head & 0xFFFF).astype(np.int64),
    )
    return _with_fd(objects, contents) if (objects.kind >= _FD).any() else contents


def _with_fd(objects: Objects, contents: Contents) -> Contents:
    """Return the contents with the fields of the CAN FD objects filled in."""
    data = np.zeros((len(contents.key), 64), dtype=np.uint8)
    data[:, :8] = contents.data
    rows = np.flatnonzero(objects.kind == _FD)
    body = objects.body[rows]
    state = objects.words.take(body + 3)  # 8 bits each: bit count, flags, valid bytes
    contents.announced[rows] = _LENGTHS.take(objects.words.take(body) >> 24)
    contents.length[rows] = length = np.minimum(state >> 16 & 0xFF, 64)
    data[rows] = _bytes(objects, body, 20, length)

    rows = np.flatnonzero(objects.kind == _FD_64)
    body = objects.body[rows]
    head = objects.words.take(body)  # 8 bits each: channel, length code, valid bytes
    contents.announced[rows] = _LENGTHS.take(head >> 8 & 0xFF)
    contents.channel[rows] = head & 0xFF
    contents.length[rows] = length = head.astype(np.int64) >> 16 & 0xFF
    contents.is_remote[rows] = objects.words.take(body + 3) & 0x10 != 0
    # valid bytes beyond the object's end, or beyond the start of its extension, are zero
    behind = (objects.words.take(body + 8) >> 24).astype(np.int64)
    size, at = objects.size[rows], objects.at[rows]
    header, own = (objects.words.take(at + 1) & 0xFFFF).astype(np.int64), 4 * (body - at)
    there = np.where(behind, behind, size) - own - _FD_64_BYTES
    end = own + _FD_64_BYTES + np.minimum(length, there)
    contents.is_outside[rows] = (header != own) | (there < 0) | (end > size)
    data[rows] = _bytes(objects, body, 40, np.minimum(length, there))
    return contents._replace(data=data)


def _bytes(
    objects: Objects, body: IntArray, offset: int, length: NDArray[np.integer[Any]]
) -> NDArray[np.uint8]:
    """Return (n, 64) bytes from ``offset`` in the bodies, zero after each length."""
    data = gathered(objects.data, offset, 4 * body, 64)
    data[np.arange(64) >= length[:, np.newaxis]] = 0
    return data
