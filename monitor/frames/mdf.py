"""CAN frames in MDF 4 files, and a check of the block structure that detects a cut file.

The MDF libraries fail in many ways, some silent, on a file that ends too early. python-can takes
60 microseconds per frame, so this module reads a channel group in blocks of many frames.
"""

import io
import logging
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

from monitor.base.types import FrameBlock
from monitor.frames.blocks import (
    EXTENDED,
    FRAMES,
    LATEST_S,
    MAX_BYTES,
    CutShortError,
    LogCounters,
    chosen,
    joined,
)
from monitor.frames.bounds import TABLE_RATIO, check_ratio, is_on_disk
from monitor.frames.channels import Channels

_FINISHED, _UNFINISHED = b"MDF     ", b"UnFinMF "
_DATA: Final = (b"DT", b"SD", b"RD", b"DV", b"DI")  # blocks of records
_BUS_EVENT: Final = 2  # flag of channel groups with bus events
_BLOCK_HEADER: Final = struct.Struct("<4s4xQQ")  # id, length, number of links
_FLAGS, _LAST_LENGTH = 60, 1 << 2  # byte of the unfinished parts; length of the last data block
_LENGTH: Final = struct.Struct("<Q")  # eight bytes behind a block's begin
_FIRST_BLOCK: Final = 64  # byte after the identification
_FIELDS: Final = 32  # bytes of a block after its links that are looked at
_CHANNEL_GROUP: Final = struct.Struct("<QQH6xII")  # record id, records, flags, sizes
_VARIABLE_LENGTH: Final = 1  # flag of a channel group
_CHANNEL: Final = struct.Struct("<3xBII")  # bit, byte, bits
_PACKED: Final = struct.Struct("<8xQ")  # unpacked bytes
_IN_LISTS: Final = (b"DG", b"CG", b"CN", b"FH", b"CH", b"DL", b"AT", b"EV")  # by first link


def mended(file: IO[bytes]) -> tuple[Path | io.BytesIO, str]:
    """Return an MDF 4 file as asammdf can read it, and why it ends too early, "" if it does not.

    The links are followed from the header through all blocks. A logger that is switched off leaves
    a file marked as unfinished: its last data block may have any length, its counts are wrong.
    asammdf mends the counts, and the length of a block that is not packed and says less than
    there is. Raises ValueError if the file is no MDF 4 file, or a finished one is incomplete.
    """
    mark = file.read(8)
    if mark not in (_FINISHED, _UNFINISHED):
        raise ValueError("not an MDF file")
    is_open = mark == _UNFINISHED
    if file.read(1) != b"4":
        raise ValueError("an MDF file of a version before 4")
    size = file.seek(0, 2)
    blocks = _Blocks(size)
    seen, beyond = set[int](), list[int]()
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
        name, length, n_links = _BLOCK_HEADER.unpack(head)
        if name[:2] != b"##" or length < _BLOCK_HEADER.size + 8 * n_links:
            raise ValueError(f"no MDF block at byte {address}")
        if address + length > size:
            if not is_open or name[2:] not in _DATA:
                raise ValueError(f"the block at byte {address} ends too early")
            beyond.append(address)
        links = [target for (target,) in struct.iter_unpack("<Q", file.read(8 * n_links))]
        blocks.add(address, name[2:], links, file.read(_FIELDS))
        waiting.extend(target for target in links if target)
    blocks.check_channels()
    file.seek(0)
    early = "the file was never closed" if is_open else ""
    has_no_length = is_open and (bool(beyond) or not blocks.has_plain)
    if is_on_disk(file) and not has_no_length:
        return Path(file.name), early
    content = io.BytesIO(file.read())
    if has_no_length:
        bytes_of = content.getbuffer()
        bytes_of[_FLAGS] &= 0xFF ^ _LAST_LENGTH
        for address in beyond:
            _LENGTH.pack_into(bytes_of, address + 8, size - address)
    return content, early


class _Blocks:
    """Bounds on the sizes that the blocks of a file announce: the libraries believe them.

    size : bytes of the file
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self.has_plain = False  # a data block that is not packed
        self._unpacked = 0  # bytes of records that the channel groups and packed blocks announce
        self._groups: list[tuple[int, int]] = []  # first channel, bytes of a record
        self._channels: dict[int, tuple[list[int], int]] = {}  # next and part; last bit
        self._next: set[int] = set()  # blocks that another one of its kind names as the next

    def add(self, address: int, name: bytes, links: list[int], fields: bytes) -> None:
        """Look at a block; raises ValueError if its list has no end, BoundError for its size.

        fields : the first bytes after its links
        """
        self.has_plain |= name in _DATA
        if name in _IN_LISTS and links and links[0]:
            if links[0] in self._next:
                raise ValueError(f"two blocks name the block at byte {links[0]} as the next")
            self._next.add(links[0])
        if name == b"CG" and len(links) > 1 and len(fields) >= _CHANNEL_GROUP.size:
            _, n_records, flags, low, high = _CHANNEL_GROUP.unpack_from(fields)
            if flags & _VARIABLE_LENGTH:  # one number, the bytes of all records
                self._unpacked += low | high << 32
            else:  # bytes of data and of validity in each record
                self._groups.append((links[1], low))
                self._unpacked += n_records * (low + high)
                check_ratio(self._size, low + high, TABLE_RATIO)
        elif name == b"CN" and len(fields) >= _CHANNEL.size:
            bit, byte, n_bits = _CHANNEL.unpack_from(fields)
            self._channels[address] = (links[:2], 8 * byte + bit + n_bits)
        elif name == b"DZ" and len(fields) >= _PACKED.size:
            (n_unpacked,) = _PACKED.unpack_from(fields)
            check_ratio(self._size, n_unpacked, TABLE_RATIO)
        check_ratio(self._size, self._unpacked, TABLE_RATIO)

    def check_channels(self) -> None:
        """Raise ValueError for a channel beyond its record, which asammdf's C code would read."""
        for first, n_bytes in self._groups:
            waiting, seen = [first], set[int]()
            while waiting:
                address = waiting.pop()
                if address not in self._channels or address in seen:
                    continue
                seen.add(address)
                links, end = self._channels[address]
                if end > 8 * n_bytes:
                    raise ValueError(
                        f"the channel at byte {address} lies beyond its record of {n_bytes} bytes"
                    )
                waiting += links


@contextmanager
def quiet() -> Iterator[None]:
    """Silence asammdf: it logs and prints tracebacks of errors that it also raises."""
    logger = logging.getLogger("asammdf")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        with redirect_stdout(io.StringIO()):
            yield
    finally:
        logger.setLevel(level)


def read_blocks(
    file: IO[bytes], counters: LogCounters, channels: Channels | None = None
) -> Iterator[FrameBlock]:
    """Yield the CAN frames of all channel groups in order of time.

    Error frames and remote frames are skipped and counted.
    Raises CutShortError behind the frames of a file that was never closed, ValueError if the file
    is damaged; asammdf may raise other errors.
    """
    from asammdf import MDF  # noqa: PLC0415

    (source, early), channels = mended(file), channels or Channels()
    with quiet(), MDF(source) as measurement:
        start_us = round(measurement.header.start_time.timestamp() * 1e6)
        channel_groups: list[Any] = list(measurement.groups)
        groups: list[Iterator[FrameBlock]] = []
        for number, group in enumerate(channel_groups):
            names = {channel.name for channel in group.channels}
            n = group.channel_group.cycles_nr
            if not group.channel_group.flags & _BUS_EVENT or n == 0:
                continue
            if "CAN_DataFrame" in names:
                groups.append(_group_blocks(measurement, number, n, start_us, channels))
            elif names & {"CAN_ErrorFrame", "CAN_RemoteFrame"}:
                counters.skipped += n
        for block in _merged(groups):
            counters.frames += len(block.t_ns)
            yield block
    if early:
        raise CutShortError(early)


def _group_blocks(
    measurement: Any, number: int, n: int, start_us: int, channels: Channels
) -> Iterator[FrameBlock]:
    """Yield the frames of a channel group with n records, in its order."""
    for first in range(0, n, FRAMES):
        count = min(FRAMES, n - first)
        signal = measurement.get(
            "CAN_DataFrame", group=number, record_offset=first, record_count=count
        )
        if len(signal.timestamps):
            block, fields = _frames(signal, start_us)
            if "BusChannel" in fields:
                block = channels.keep_numbered(block, fields["BusChannel"])
            if len(block.t_ns):
                yield block


def _merged(groups: Sequence[Iterator[FrameBlock]]) -> Iterator[FrameBlock]:
    """Yield the frames of several groups in order of time.

    Within a group a later block holds no earlier frame; MDF demands rising times of a group.
    """
    held = {number: block for number, group in enumerate(groups) if (block := next(group, None))}
    while held:
        until_ns = min(int(block.t_ns.max()) for block in held.values())
        merged = joined([chosen(block, block.t_ns <= until_ns) for block in held.values()])
        if np.any(merged.t_ns[1:] < merged.t_ns[:-1]):
            merged = chosen(merged, np.argsort(merged.t_ns, kind="stable"))
        yield merged
        later = ((number, chosen(block, block.t_ns > until_ns)) for number, block in held.items())
        following = ((n, rest if len(rest.t_ns) else next(groups[n], None)) for n, rest in later)
        held = {number: block for number, block in following if block}


def _frames(signal: Any, start_us: int) -> tuple[FrameBlock, dict[str, Any]]:
    """Return the frames of one channel group, and its fields by name."""
    samples = signal.samples
    fields = {name.rpartition(".")[2]: samples[name] for name in samples.dtype.names}
    times_us = (signal.timestamps * 1e6).round()
    if not np.all(np.abs(times_us + start_us) < LATEST_S * 1e6):
        raise ValueError("a frame later than 64 bits of nanoseconds hold")
    payload = fields["DataBytes"]
    length = np.minimum(fields["DataLength"], payload.shape[1])
    if length.max(initial=0) > MAX_BYTES:
        raise ValueError(f"a frame of {length.max()} bytes, CAN FD has {MAX_BYTES} at most")
    width = 8 if length.max(initial=0) <= 8 else MAX_BYTES
    data = np.zeros((len(length), width), dtype=np.uint8)
    columns = min(width, payload.shape[1])
    data[:, :columns] = payload[:, :columns]
    data[np.arange(width) >= length[:, np.newaxis]] = 0
    key = fields["ID"].astype(np.uint32) & np.uint32(0x1FFFFFFF)
    if "IDE" in fields:
        key |= (fields["IDE"] != 0) * np.uint32(EXTENDED)
    t_ns = (times_us.astype(np.int64) + start_us) * 1000
    return FrameBlock(t_ns, key, length.astype(np.uint8), data), fields
