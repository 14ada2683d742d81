"""Readers of CAN logs compared: in blocks, frame by frame, and python-can's readers.

All read the same synthetic log of a full bus (4,000 frames/s). Readers take turns. Figures are
medians over the rounds in processor time. The cost of unpacking (zlib, gzip) is measured in the
same rounds, as the lower bound of readers that need it.

python -m benchmarks log_readers [--seconds 60] [--rounds 5]
"""

import tempfile
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

import can

from benchmarks.measures import cpu_s, in_turn
from benchmarks.outcome import BenchmarkOptions, Row, finish
from benchmarks.speed import traffic
from monitor.frames import mdf
from monitor.frames.blf import structure
from monitor.frames.bounds import open_binary
from monitor.frames.logs import read_blocks, read_frames
from training.recordings.files.can_log import write_log

FORMATS = (".log", ".log.gz", ".blf", ".mf4")
AT_ONCE = "at once"
CANDUMP_TARGET = 1500.0  # times real time: parsing must take well below half of the way to verdicts

Reader = Callable[[Path], int]  # returns the number of frames


def at_once(path: Path) -> int:
    """Read in blocks."""
    return sum(len(block.t_ns) for block in read_blocks(path))


def one_by_one(path: Path) -> int:
    """Read frame by frame."""
    return sum(1 for _ in read_frames(path))


def python_can(path: Path) -> int:
    """Read with python-can."""
    with can.LogReader(path) as reader, mdf.quiet():
        return sum(1 for _ in reader)


def unpacked(path: Path) -> int:
    """Unpack and look at nothing."""
    with open_binary(path) as file:
        if path.suffix == ".blf":
            for _, body in structure.objects(file, structure.header_of(file)):
                zlib.decompressobj().decompress(body[16:])
        else:
            while file.read(1 << 20):
                pass
    return 0


def measure(path: Path, suffix: str, rounds: int, n_frames: int, log_s: float) -> list[Row]:
    """Return a row for each reader of a log."""
    readers: dict[str, Reader] = {AT_ONCE: at_once, "one by one": one_by_one}
    if suffix in {".blf", ".log.gz"}:
        readers["unpacking alone"] = unpacked
    readers["python-can"] = python_can

    def timed(read: Reader) -> float:
        counts: list[int] = []
        took_s = cpu_s(lambda: counts.append(read(path)))
        if counts[0] not in {0, n_frames}:
            raise AssertionError(f"{counts[0]} of {n_frames} frames of {path.name} were read")
        return took_s

    seconds = in_turn({name: lambda r=r: timed(r) for name, r in readers.items()}, rounds)
    mb = path.stat().st_size / 1e6
    return [
        {
            "log": suffix,
            "mb": mb,
            "reader": name,
            "ns_per_frame": each / n_frames * 1e9,
            "mb_per_s": mb / each,
            "x real time": log_s / each,
            "/ at once": each / seconds[AT_ONCE],
        }
        for name, each in seconds.items()
    ]


def main(argv: Sequence[str]) -> int:
    """Compare the readers; return 1 if candump text is read too slowly."""
    options = BenchmarkOptions(__name__, __doc__, seconds=2.0, rounds=1)
    options.add_argument("--seconds", type=float, default=60.0, help="length of the log")
    options.add_argument("--rounds", type=int, default=5)
    args = options.parse_args(argv)
    frames = traffic.full_bus(args.seconds)
    n, log_s = len(frames.t_ns), float(frames.t_ns[-1] - frames.t_ns[0]) * 1e-9
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for suffix in FORMATS:
            path = Path(folder) / f"full{suffix}"
            write_log(path, frames)
            rows += measure(path, suffix, args.rounds, n, log_s)
    reached = float(rows[0]["x real time"] or 0.0)
    slow = f"candump text {reached:.0f} times real time, wanted {CANDUMP_TARGET:g}"
    return finish(args, rows, [slow] * (not args.smallest and reached < CANDUMP_TARGET))
