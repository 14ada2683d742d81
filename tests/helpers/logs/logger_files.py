"""Small writers of loggers' files, for tests: MLG of both versions, text tables, Haltech."""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monitor.base.types import FloatArray
from monitor.frames.tables.raw_table import Notes, RawTable, Wanted

CODES = {"u1": 0, "i1": 1, ">u2": 2, ">i2": 3, ">u4": 4, ">i4": 5, ">i8": 6, ">f4": 7}
TUNER_UNITS = {  # signal → (column, unit, factor and offset of signal = factor x + offset)
    "lambda_measured": ("AFR", "AFR", 1 / 14.7, 0.0),
    "manifold_pressure_kpa": ("MAP", "psi", 6.894757, 0.0),
    "manifold_temperature_degc": ("MAT", "°F", 1 / 1.8, -32 / 1.8),
    "coolant_temperature_degc": ("CLT", "°F", 1 / 1.8, -32 / 1.8),
    "vehicle_speed_km_h": ("VSS", "mph", 1.609344, 0.0),
    "maf_kg_h": ("MAF", "g/s", 3.6, 0.0),
}


@dataclass(frozen=True, slots=True)
class Field:
    """One field of an MLG log."""

    name: str
    unit: str = ""
    dtype: str = ">f4"
    scale: float = 1.0
    transform: float = 0.0


def mlg_header(version: int, fields: Sequence[Field], info: str = "") -> bytes:
    size = 55 if version == 1 else 89
    start = 22 if version == 1 else 24
    record = sum(np.dtype(field.dtype).itemsize for field in fields)
    text_at = start + size * len(fields)
    text = info.encode() + b"\0"
    head = b"MLVLG\0" + struct.pack(">HI", version, 1_700_000_000)
    packing = ">HIHH" if version == 1 else ">IIHH"
    head += struct.pack(packing, text_at, text_at + len(text), record, len(fields))
    for field in fields:
        entry = bytes([CODES[field.dtype]])
        entry += field.name.encode()[:34].ljust(34, b"\0") + field.unit.encode().ljust(10, b"\0")
        entry += b"\0" + struct.pack(">ff", field.scale, field.transform) + b"\3"
        head += entry.ljust(size, b"\0")
    return head + text


def mlg_blocks(
    fields: Sequence[Field], values: FloatArray, t_s: FloatArray, first: int = 0
) -> list[bytes]:
    """Return the data blocks of the values, (n, n_fields), with counter, time and checksum."""
    blocks = []
    for k, (row, t) in enumerate(zip(values, t_s, strict=True), first):
        data = b"".join(
            np.array([_raw(field, value)], dtype=field.dtype).tobytes()
            for field, value in zip(fields, row, strict=True)
        )
        head = bytes([0, k % 256]) + struct.pack(">H", round(t * 1e5) % 65536)
        blocks.append(head + data + bytes([sum(data) % 256]))
    return blocks


def _raw(field: Field, value: float) -> float:
    raw = value / field.scale - field.transform
    return raw if field.dtype == ">f4" else round(raw)


def mlg_marker(text: str, t_s: float) -> bytes:
    return b"\1\0" + struct.pack(">H", round(t_s * 1e5) % 65536) + text.encode().ljust(50, b"\0")


def write_mlg(
    path: Path,
    fields: Sequence[Field],
    values: FloatArray,
    t_s: FloatArray,
    *,
    version: int = 2,
    info: str = "",
) -> Path:
    blocks = mlg_blocks(fields, values, t_s)
    path.write_bytes(mlg_header(version, fields, info) + b"".join(blocks))
    return path


def cells_of(raw: RawTable) -> tuple[FloatArray, Notes]:
    """Return all cells of a table, and what is to be told of it."""
    notes = Notes()
    blocks = raw.read([Wanted(i) for i in range(len(raw.columns))], notes)
    return np.concatenate(list(blocks)), notes


def write_text_table(
    path: Path,
    columns: Mapping[str, FloatArray | Sequence[str]],
    *,
    separator: str = ",",
    comma: bool = False,
    encoding: str = "utf-8",
    preamble: Sequence[str] = (),
    units: Sequence[str] = (),
    quoted: bool = False,
) -> Path:
    def cell(value: object) -> str:
        text = value if isinstance(value, str) else f"{value:.6g}"
        text = text.replace(".", ",") if comma and not isinstance(value, str) else text
        return f'"{text}"' if quoted else text

    rows = [list(columns), *([list(units)] if units else []), *zip(*columns.values(), strict=True)]
    lines = [*preamble, *(separator.join(map(cell, row)) for row in rows)]
    path.write_bytes(("\r\n".join(lines) + "\r\n").encode(encoding))
    return path


def drive(n: int = 600, period_s: float = 0.1, seed: int = 0) -> dict[str, NDArray[np.float64]]:
    """Return a plausible drive in a tuner's units, one array each."""
    rng = np.random.default_rng(seed)
    t = period_s * np.arange(n)
    load = 0.5 + 0.3 * np.sin(0.4 * t) + 0.1 * np.sin(1.7 * t + 1.0)
    afr = 14.7 * (1.0 + 0.05 * np.sin(0.9 * t)) + 0.02 * rng.standard_normal(n)
    return {
        "t_s": t,
        "rpm": 2000.0 + 800.0 * load,
        "map_kpa": 25.0 + 80.0 * load,
        "afr": afr,
        "pw_ms": 1.0 + 7.0 * load,
        "clt_c": np.full(n, 88.0) + 0.01 * t,
        "iat_c": 25.0 + 0.02 * t,
        "battery_v": 13.8 + 0.05 * rng.standard_normal(n),
        "ego_percent": 100.0 + 3.0 * np.sin(0.9 * t),
        "ve_percent": 60.0 + 20.0 * load,
    }
