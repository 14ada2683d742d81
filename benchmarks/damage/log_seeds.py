"""A short healthy drive in every format that ``o2mon replay`` reads, to be damaged.

The drive is a stretch of a simulated WLTC in which the test completes: undamaged, each file ends
with exit code 0. CAN logs hold its frames, tables its samples: the project's own columns (CSV,
Parquet) and a logger's (CSV, MSL, MLG), with the units of a tuner and a profile that is found by
its columns in the folder of the logs.
"""

import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from benchmarks.repository import REPLAY_LOGS
from monitor.base.types import FloatArray, Frame
from monitor.frames.logs import read_frames
from monitor.inject.gateway import write_log
from tests.helpers.logger_files import TUNER_UNITS
from training.recordings.frame_block import FrameBlock
from training.recordings.mf4_log import write_mf4
from training.recordings.recording import Recording, load
from training.recordings.table_files import write_table

DRIVE = REPLAY_LOGS / "healthy_wltc_3b_v101_s101.blf"
BEGIN_S, LENGTH_S = 200.0, 30.0
LOGS = (".log", ".asc", ".csv", ".trc", ".blf", ".mf4")
OWN = (".table.csv", ".parquet")
LOGGERS = (".logger.csv", ".msl", ".mlg")
KINDS = (*LOGS, *OWN, *LOGGERS)
BINARY_KINDS = (".blf", ".mf4", ".parquet", ".mlg")
PROFILE = "tuner.toml"


def write_seeds(folder: Path) -> None:
    """Write the drive in every format as ``seedKIND``, and the logger's profile."""
    frames = stretch(BEGIN_S, LENGTH_S)
    for kind in LOGS:
        if kind == ".mf4":
            write_mf4(folder / "seed.mf4", side_by_side(frames))
        else:
            write_log(folder / f"seed{kind}", frames)
    drive = load(folder / "seed.log", period_s=0.1)
    held = np.nan_to_num(drive.values, nan=1.0)
    for kind in OWN:
        write_table(folder / f"seed{kind}", drive.t_s, drive.names, held)
    columns = _as_logged(drive)
    (folder / PROFILE).write_text(_profile(drive))
    (folder / "seed.logger.csv").write_bytes(_text(columns, ",", "utf-8"))
    (folder / "seed.msl").write_bytes(_text(columns, "\t", "latin-1"))
    (folder / "seed.mlg").write_bytes(_mlg(columns))


def stretch(begin_s: float, length_s: float) -> list[Frame]:
    """Return the frames of a stretch of the drive."""
    frames = read_frames(DRIVE)
    first = next(frames)
    begin_ns = first.t_ns + round(begin_s * 1e9)
    end_ns = begin_ns + round(length_s * 1e9)
    found = []
    for frame in frames:
        if frame.t_ns >= end_ns:
            break
        if frame.t_ns >= begin_ns:
            found.append(frame)
    return found


def side_by_side(frames: list[Frame]) -> FrameBlock:
    """Return frames of 8 bytes as one block."""
    return FrameBlock(
        np.array([f.t_ns for f in frames]),
        np.array([f.can_id for f in frames]),
        np.array([f.is_extended for f in frames]),
        np.array([len(f.data) for f in frames]),
        np.array([list(f.data.ljust(8, b"\0")) for f in frames], dtype=np.uint8),
    )


def _as_logged(drive: Recording) -> dict[tuple[str, str], FloatArray]:
    """Return the drive's columns by name and unit, as the logger has them."""
    columns = {("Time", "s"): drive.t_s}
    for name, values in zip(drive.names, drive.values.T, strict=True):
        column, unit, factor, offset = TUNER_UNITS.get(name, (f"own {name}", "", 1.0, 0.0))
        columns[column, unit] = (np.nan_to_num(values, nan=1.0) - offset) / factor
    return columns


def _profile(drive: Recording) -> str:
    names = (f'{n} = "{TUNER_UNITS.get(n, (f"own {n}",))[0]}"\n' for n in drive.names)
    found_by = '[[recognise]]\ncolumns = ["own lambda_controller", "own fuel_mass_mg"]\n'
    return f'time = ["Time", "MLG timestamp"]\n{found_by}[signals]\n{"".join(names)}'


def _text(columns: Mapping[tuple[str, str], FloatArray], separator: str, encoding: str) -> bytes:
    rows = [[name for name, _ in columns], [unit for _, unit in columns]]
    rows += [[f"{x:.7g}" for x in row] for row in zip(*columns.values(), strict=True)]
    return "".join(separator.join(row) + "\r\n" for row in rows).encode(encoding)


def _mlg(columns: Mapping[tuple[str, str], FloatArray]) -> bytes:
    """Return an MLG log of version 2, all fields floats of 32 bits."""
    fields = list(columns)[1:]
    head = b"MLVLG\0" + struct.pack(">HI", 2, 1_700_000_000)
    text_at = 24 + 89 * len(fields)
    head += struct.pack(">IIHH", text_at, text_at + 1, 4 * len(fields), len(fields))
    for name, unit in fields:
        entry = bytes([7]) + name.encode()[:34].ljust(34, b"\0")
        entry += unit.encode("latin-1")[:10].ljust(10, b"\0") + b"\0" + struct.pack(">ff", 1.0, 0.0)
        head += (entry + b"\3").ljust(89, b"\0")
    blocks = [head, b"\0"]
    t_s, *values = columns.values()
    for k, (t, *row) in enumerate(zip(t_s, *values, strict=True)):
        data = struct.pack(f">{len(row)}f", *row)
        begin = bytes([0, k % 256]) + struct.pack(">H", round(t * 1e5) % 65536)
        blocks.append(begin + data + bytes([sum(data) % 256]))
    return b"".join(blocks)
