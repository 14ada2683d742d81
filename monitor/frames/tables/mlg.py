"""MegaLogViewer's binary logs (.mlg), versions 1 and 2, as TunerStudio, rusEFI and Speeduino write.

All numbers are big endian. Header: ``MLVLG\\0``, version, time, start of the text, start of the
data, bytes per record, number of fields; then 55 bytes per field (version 1) or 89 (version 2).
Data blocks begin with type, counter and a timestamp of 10 µs that wraps after 0.66 s. Type 0 is a
record, with a checksum behind it: the sum of its bytes; type 1 is a marker with 50 bytes of text.
Value = scale * (raw + transform). Source: the files themselves and the public converters.
"""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from monitor.frames.bounds import open_binary
from monitor.frames.tables.dialect import one_line
from monitor.frames.tables.mlg_blocks import BLOCK_HEAD, Blocks
from monitor.frames.tables.raw_table import Notes, RawColumn, RawTable, Wanted

MAGIC: Final = b"MLVLG\0"
TIMESTAMP: Final = "MLG timestamp"  # name of the column of unwrapped timestamps, in s

_TYPES: Final = {0: "u1", 1: "i1", 2: ">u2", 3: ">i2", 4: ">u4", 5: ">i4", 6: ">i8", 7: ">f4"}
_BITS: Final = {10: "u1", 11: ">u2", 12: ">u4", 0x10: "u1", 0x11: ">u2", 0x12: ">u4"}
_FIELD_BYTES: Final = {1: 55, 2: 89}
_TICK_S: Final = 1e-5
_WRAP: Final = 1 << 16
_MOST_FIELDS: Final = 20_000
MOST_NAMES: Final = 4 << 20  # bytes of the names of bits


@dataclass(frozen=True, slots=True)
class _Field:
    name: str
    unit: str
    dtype: str
    scale: float
    transform: float
    bit: int | None = None  # of a bit field


class _MlgLayout(NamedTuple):
    fields: tuple[_Field, ...]
    offsets: tuple[int, ...]  # of the fields within a record
    data: int  # byte of the first block
    record: int  # bytes of a record


def open_mlg(path: Path) -> RawTable:
    """Return the log in ``path``.

    Raises RecordingError if it is no MLG log, or of an unknown version.
    """
    with open_binary(path) as file:
        version, layout, text = _header(path, file)
    columns = tuple(RawColumn(each.name, each.unit) for each in layout.fields)
    return RawTable(
        path,
        f"MegaLogViewer binary log, version {version}",
        (*columns, RawColumn(TIMESTAMP, "s")),
        partial(_read, path, layout),
        text,
    )


def _header(path: Path, file: BinaryIO) -> tuple[int, _MlgLayout, str]:
    head = _wanted_bytes(path, file, 24)
    if head[:6] != MAGIC:
        raise RecordingError(f"{path}: begins with {head[:6]!r}, an MLG log begins with {MAGIC!r}")
    version = int.from_bytes(head[6:8])
    if version not in _FIELD_BYTES:
        raise RecordingError(f"{path}: MLG version {version}, versions 1 and 2 are read")
    packed = ">HIHH" if version == 1 else ">IIHH"
    info, data, record, n = struct.unpack_from(packed, head, 12)
    size, start = _FIELD_BYTES[version], 12 + struct.calcsize(packed)
    if not 0 < n <= _MOST_FIELDS:
        raise RecordingError(f"{path}: {n} fields, 1 to {_MOST_FIELDS} are wanted")
    if data < start + n * size:
        raise RecordingError(f"{path}: data from byte {data}, within the {n} fields before it")
    body = head[start:] + _wanted_bytes(path, file, start + n * size - len(head))
    entries = [body[i * size : (i + 1) * size] for i in range(n)]
    rest = file.read(min(data - start - n * size, MOST_NAMES))
    names = _Names(rest[: max(info - start - n * size, 0)], start + n * size)
    fields, offsets, at = [], [], 0
    for number, entry in enumerate(entries, 1):
        kind = entry[0]
        dtype = _TYPES.get(kind) or _BITS.get(kind)
        if dtype is None:
            raise RecordingError(f"{path}: field {number}: type {kind}, 0 to 7 or 10 to 12 wanted")
        each = _bits(entry, dtype, names) if kind in _BITS else [_scalar(entry, dtype)]
        fields += each
        offsets += [at] * len(each)
        at += np.dtype(dtype).itemsize
    if at != record:
        raise RecordingError(f"{path}: records of {record} bytes, its {n} fields take {at}")
    text = rest[info - start - n * size :][:20_000] if info else b""
    return version, _MlgLayout(tuple(fields), tuple(offsets), data, record), _text(text)


def _wanted_bytes(path: Path, file: BinaryIO, n: int) -> bytes:
    data = file.read(n)
    if len(data) < n:
        raise RecordingError(f"{path}: the log ends within its header")
    return data


def _scalar(entry: bytes, dtype: str) -> _Field:
    scale, transform = struct.unpack_from(">ff", entry, 46)
    scale = float(f"{scale:.7g}")  # the decimal that 32 bits stand for: 0.1, not 0.10000000149
    return _Field(_text(entry[1:35]), _text(entry[35:45]), dtype, scale, transform)


class _Names(NamedTuple):
    text: bytes  # names of bits, a zero behind each
    start: int  # its byte in the file

    def of(self, index: int, n: int) -> list[bytes]:
        """Return ``n`` names from an index, which counts from the text's start or the file's."""
        first = index - self.start if index >= self.start else index
        return self.text[first:].split(b"\0")[:n]


def _bits(entry: bytes, dtype: str, names: _Names) -> list[_Field]:
    """Return one field per bit that has a name."""
    (index,), count = struct.unpack_from(">I", entry, 46), entry[50]
    own = names.of(index, min(count, 8 * np.dtype(dtype).itemsize))
    group = _text(entry[1:35])
    return [
        _Field(f"{group}: {_text(name)}", "", dtype, 1.0, 0.0, bit)
        for bit, name in enumerate(own)
        if name and _text(name) != "INVALID"
    ] or [_Field(group, "", dtype, 1.0, 0.0)]


def _text(data: bytes) -> str:
    """Return a name, unit or signature, which ends with a zero, in one line."""
    text = data.partition(b"\0")[0]
    try:
        return one_line(text.decode("utf-8"))
    except UnicodeDecodeError:
        return one_line(text.decode("cp1252", errors="replace"))


def _read(
    path: Path, layout: _MlgLayout, wanted: Sequence[Wanted], notes: Notes
) -> Iterator[FloatArray]:
    """Yield the wanted fields, (n, n_wanted), of one chunk after the other."""
    last, ticks = None, np.zeros(1, dtype=np.int64)
    with open_binary(path) as file:
        file.seek(layout.data)
        for records in Blocks(layout.record).of(file, notes):
            stamps = records[:, 2].astype(np.int64) * 256 + records[:, 3]
            steps = np.diff(stamps, prepend=stamps[0] if last is None else last) % _WRAP
            last, ticks = stamps[-1], ticks[-1] + np.cumsum(steps)
            out = np.empty((len(records), len(wanted)))
            for i, each in enumerate(wanted):
                column = each.column
                out[:, i] = (
                    ticks * _TICK_S
                    if column == len(layout.fields)
                    else _values(records, layout.fields[column], layout.offsets[column])
                )
            yield out


def _values(records: NDArray[np.uint8], field: _Field, offset: int) -> FloatArray:
    start = BLOCK_HEAD + offset
    size = np.dtype(field.dtype).itemsize
    raw = np.ascontiguousarray(records[:, start : start + size]).view(field.dtype)[:, 0]
    if field.bit is not None:
        return ((raw.astype(np.int64) >> field.bit) & 1).astype(np.float64)
    values = raw.astype(np.float64)
    if field.transform:
        values += field.transform
    return values if field.scale == 1.0 else values * field.scale
