"""Time and memory of reading a large MegaLogViewer log, and of what a user would write instead.

The log is generated: 190,000 records of 979 channels, 500 MB (as a rusEFI with all its channels
writes in half an hour). Read are the canonical signals, as ``o2mon replay`` does, and all channels,
each in a process of its own that counts its peak memory. No reader of this format stands on PyPI;
the comparison is the plain loop of the public converters: one ``struct.unpack`` per record.

Targets: 60 s and 300 MB.

python -m benchmarks mlg_reader [--records 190000] [--channels 979] [--keep FILE]
"""

import argparse
import struct
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from benchmarks.measures import benchmark_call, peak_mb
from benchmarks.outcome import BenchmarkOptions, Row, finish
from monitor.frames.tables.raw_table import Notes, Wanted
from monitor.frames.tables.readers import open_table
from monitor.grid.tables import read_table
from tests.helpers.logs.logger_files import Field, mlg_header

TARGET_S, TARGET_MB = 60.0, 300.0
BLOCK = 2000  # records written at once
KNOWN = (
    *(("RPM", 1.0), ("MAP", 1 / 30), ("Lambda", 1e-4), ("CLT", 0.01), ("VBatt", 0.001)),
    ("Fuel: Last inj pulse width", 1 / 300),
)
BYTES = 2.68  # of a channel on average: 500 MB / 190,000 / 979


def fields(n_channels: int) -> list[Field]:
    """Return the channels; two thirds have four bytes."""
    named = [Field("Time"), *(Field(name, "", ">u2", scale) for name, scale in KNOWN)]
    rest = n_channels - len(named)
    wide = round((BYTES - 2.0) / 2.0 * rest)
    kinds = [">f4" if i < wide else ">u2" for i in range(rest)]
    return named + [Field(f"Channel {i:03d}", "", kind) for i, kind in enumerate(kinds)]


def write(path: Path, n_records: int, n_channels: int) -> None:
    """Write a version 2 log with marks of time every 10 ms."""
    every = fields(n_channels)
    record = np.dtype([(f"f{i}", field.dtype) for i, field in enumerate(every)])
    block = np.dtype([("head", "u1", 2), ("t", ">u2"), ("data", record), ("sum", "u1")])
    rng = np.random.default_rng(1)
    with path.open("wb") as file:
        file.write(mlg_header(2, every, '"rusEFI (benchmark)"'))
        for first in range(0, n_records, BLOCK):
            n = min(BLOCK, n_records - first)
            rows = np.zeros(n, block)
            k = first + np.arange(n)
            rows["head"][:, 1] = k % 256
            rows["t"] = (k * 1000) % 65536
            for i, field in enumerate(every):
                noise = rng.integers(900, 10_000, n).astype(field.dtype)
                rows["data"][f"f{i}"] = k * 0.01 if field.name == "Time" else noise
            data = np.frombuffer(rows["data"].tobytes(), np.uint8).reshape(n, -1)
            rows["sum"] = data.sum(axis=1, dtype=np.uint64) % 256
            file.write(rows.tobytes())


def canonical(path: Path) -> int:
    """Read the canonical signals."""
    return int(read_table(path).values.size)


def everything(path: Path) -> int:
    """Read every channel, block by block."""
    raw = open_table(path)
    wanted = [Wanted(i) for i in range(len(raw.columns))]
    return sum(int(block.size) for block in raw.read(wanted, Notes()))


def plain_loop(path: Path) -> int:
    """Read every channel as the public converters do, one record at a time."""
    count = 0
    with path.open("rb") as file:
        head = file.read(24)
        _, data_at, _, n = struct.unpack(">IIHH", head[12:24])
        entries = [file.read(89) for _ in range(n)]
        code = {2: "H", 7: "f"}
        record = struct.Struct(">" + "".join(code[entry[0]] for entry in entries))
        scales = [struct.unpack(">f", entry[46:50])[0] for entry in entries]
        file.seek(data_at)
        while head := file.read(4):
            if len(head) < 4:
                break
            values = record.unpack(file.read(record.size))
            file.read(1)
            count += len([value * scale for value, scale in zip(values, scales, strict=True)])
    return count


WAYS: dict[str, Callable[[Path], int]] = {
    "canonical": canonical,
    "everything": everything,
    "plain_loop": plain_loop,
}


def measured(way: str, path: Path) -> Row:
    """Return what one way takes, in a process of its own."""
    command = benchmark_call("mlg_reader", "--way", way, "--keep", path)
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    seconds, peak, values = map(float, done.stdout.split())
    return {"way": way, "seconds": seconds, "peak_mb": peak, "values": int(values)}


def main(argv: Sequence[str]) -> int:
    """Read in each way; return 1 if a target is missed."""
    options = BenchmarkOptions(__name__, __doc__, records=2000, channels=100)
    options.add_argument("--records", type=int, default=190_000)
    options.add_argument("--channels", type=int, default=979)
    options.add_argument("--keep", type=Path, help="file to write, and to leave")
    options.add_argument("--way", choices=WAYS, help=argparse.SUPPRESS)
    args = options.parse_args(argv)
    if args.way:
        begun_s = time.perf_counter()
        values = WAYS[args.way](args.keep)
        print(time.perf_counter() - begun_s, peak_mb(), values)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        path = args.keep or Path(folder) / "large.mlg"
        write(path, args.records, args.channels)
        size_mb = path.stat().st_size / 1e6
        rows: list[Row] = [measured(way, path) | {"file_mb": size_mb} for way in WAYS]
    missed = [
        f"{row['way']}: {TARGET_S:g} s and {TARGET_MB:g} MB"
        for row in rows[:2]
        if float(row["seconds"] or 0.0) > TARGET_S or float(row["peak_mb"] or 0.0) > TARGET_MB
    ]
    return finish(args, rows, missed)
