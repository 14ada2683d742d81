"""Readers of CAN logs compared: in blocks, frame by frame, and python-can's readers.

All read the same synthetic log: a simulated drive of the project's own ECU among foreign traffic
that fills a bus of 500 kbit/s (4,000 frames/s). Readers take turns. Figures are medians over the
rounds in processor time, which other work on the machine hardly changes. The cost of unpacking
(zlib, gzip) is measured in the same rounds, as the lower bound of readers that need it.

    python -m benchmarks log_readers [--seconds 60] [--rounds 5] [--json FILE]
"""

import argparse
import json
import statistics
import sys
import tempfile
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from time import process_time
from typing import Any

import can

from benchmarks.speed.fleet_log import loaded
from monitor.frames import blf, mdf
from monitor.frames.bounds import open_binary
from monitor.frames.log_blocks import read_blocks
from monitor.frames.logs import read_frames
from training.recordings.can_log import write_log

FORMATS = (".log", ".log.gz", ".blf", ".mf4")
AT_ONCE = "at once"
REAL_TIME_TARGETS = {".log": 1500.0}  # parsing must take well below half of the way to verdicts

Reader = Callable[[Path], int]  # returns the number of frames


def at_once(path: Path) -> int:
    return sum(len(block.t_ns) for block in read_blocks(path))


def one_by_one(path: Path) -> int:
    return sum(1 for _ in read_frames(path))


def python_can(path: Path) -> int:
    with can.LogReader(path) as reader, mdf.quiet():
        return sum(1 for _ in reader)


def unzipped(path: Path) -> int:
    """Unpack and look at nothing."""
    with open_binary(path) as file:
        if path.suffix == ".blf":
            for _, body, _ in blf.objects(file, len(file.read(144))):
                zlib.decompressobj().decompress(body[16:])
        else:
            while file.read(1 << 20):
                pass
    return 0


def readers(suffix: str) -> dict[str, Reader]:
    """Return the readers of a format, python-can's last."""
    found: dict[str, Reader] = {AT_ONCE: at_once, "one by one": one_by_one}
    if suffix in {".blf", ".log.gz"}:
        found["unpacking alone"] = unzipped
    return found | {"python-can": python_can}


def measure(path: Path, suffix: str, rounds: int, n_frames: int) -> dict[str, float]:
    """Return the median seconds of each reader of a log."""
    found = readers(suffix)
    seconds: dict[str, list[float]] = {name: [] for name in found}
    for _ in range(rounds):
        for name, read in found.items():
            start = process_time()
            n = read(path)
            seconds[name].append(process_time() - start)
            if n not in {0, n_frames}:
                raise AssertionError(f"{name} read {n} of {n_frames} frames of {path.name}")
    return {name: statistics.median(each) for name, each in seconds.items()}


def rows(seconds: dict[str, float], n_frames: int, n_bytes: int, log_s: float) -> list[Any]:
    """Return what is printed of one log."""
    return [
        {
            "reader": name,
            "ns_per_frame": each / n_frames * 1e9,
            "frames_per_s": n_frames / each,
            "mb_per_s": n_bytes / each / 1e6,
            "times_real_time": log_s / each,
            "times_at_once": each / seconds[AT_ONCE],
        }
        for name, each in seconds.items()
    ]


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0, help="length of the log")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args(argv)
    frames = loaded(args.seconds)
    n, log_s = len(frames.t_ns), float(frames.t_ns[-1] - frames.t_ns[0]) * 1e-9
    print(f"{n} frames in {log_s:.0f} s, synthetic; processor time, median of {args.rounds} rounds")
    print(
        f"{'log':9}{'MB':>6}  {'reader':16}{'ns/frame':>9}{'frames/s':>12}{'MB/s':>8}"
        f"{'x real time':>13}{'/ at once':>11}"
    )
    found: dict[str, Any] = {}
    missed = []
    with tempfile.TemporaryDirectory() as folder:
        for suffix in FORMATS:
            path = Path(folder) / f"full{suffix}"
            write_log(path, frames)
            n_bytes = path.stat().st_size
            found[suffix] = rows(measure(path, suffix, args.rounds, n), n, n_bytes, log_s)
            for row in found[suffix]:
                print(
                    f"{suffix:9}{n_bytes / 1e6:6.1f}  {row['reader']:16}{row['ns_per_frame']:9.0f}"
                    f"{row['frames_per_s']:12,.0f}{row['mb_per_s']:8.0f}"
                    f"{row['times_real_time']:13,.0f}{row['times_at_once']:11.2f}"
                )
            target = REAL_TIME_TARGETS.get(suffix, 0.0)
            if found[suffix][0]["times_real_time"] < target:
                missed.append(f"{suffix}: {target:g} times real time wanted")
    if args.json:
        args.json.write_text(json.dumps({"schema": "o2bench.log_readers/1", "logs": found}))
    print("\n".join(missed), file=sys.stderr)
    return int(bool(missed))
