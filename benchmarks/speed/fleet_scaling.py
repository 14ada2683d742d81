"""Processor time and memory per recording, from ten recordings to ten thousand.

Sixteen short drives, pieces of the shipped simulated logs, are linked under the wanted number of
names and judged by ``o2train fleet``, as logs or tables. "judging" is the workers' processor time
for reading, judging and rows; "cpu_s" is that of every process from start to report. Memory is the
largest resident set of the coordinator and of any one worker, sampled ten times a second.

python -m benchmarks fleet_scaling [--format log] [--jobs 2] [--counts 10 100 1000]
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import psutil

from benchmarks.outcome import BenchmarkOptions, Row, finish
from benchmarks.repository import REPLAY_LOGS
from monitor.decode.bus_map import load_pairs
from monitor.pipeline.replay import shipped_model
from training.recordings.files.can_log import broadcast, write_log
from training.recordings.recording import default_pairs, load, write_table

SOURCES = ("healthy_micro_trips_v102_s102.blf", "healthy_wltc_3b_v101_s101.blf")
DISTINCT = 16
SAMPLES = 1200  # of 0.1 s in a recording
SAMPLED_S = 0.1


def make(folder: Path, kind: str, number: int) -> list[Path]:
    """Write so many recordings of two minutes, at most sixteen."""
    folder.mkdir()
    bus_map = load_pairs(default_pairs())
    whole = [load(REPLAY_LOGS / name) for name in SOURCES]
    made = []
    for i in range(min(number, DISTINCT)):
        drive = whole[i % len(whole)]
        values = drive.values[i // 2 * 400 :][:SAMPLES]
        t_s = np.arange(len(values)) * (drive.period_ns / 1e9)
        path = folder / f"source_{i:02d}.{kind}"
        if kind == "parquet":
            write_table(path, t_s, drive.names, values)
        else:
            t_ns = np.rint(t_s * 1e9).astype(np.int64)
            columns = {name: values[:, k] for k, name in enumerate(drive.names)}
            write_log(path, broadcast(bus_map, t_ns, columns, None))
        made.append(path)
    return made


def link(made: list[Path], folder: Path, count: int) -> Path:
    """Link the recordings under ``count`` names."""
    folder.mkdir()
    for i in range(count):
        os.link(made[i % len(made)], folder / f"drive_{i:06d}{made[0].suffix}")
    return folder


def run(folder: Path, out: Path, jobs: int) -> Row:
    """Judge a folder; return what it took."""
    count = len(list(folder.iterdir()))
    options = ["--model", str(shipped_model()), "--out", str(out), "--jobs", str(jobs)]
    began_s, before = time.perf_counter(), os.times()
    process = subprocess.Popen(
        [sys.executable, "-m", "training.cli", "fleet", str(folder), *options],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    peak, tree = {"coordinator": 0, "worker": 0}, psutil.Process(process.pid)
    while process.poll() is None:
        try:
            peak["coordinator"] = max(peak["coordinator"], tree.memory_info().rss)
            for child in tree.children(recursive=True):
                peak["worker"] = max(peak["worker"], child.memory_info().rss)
        except psutil.Error:  # has ended meanwhile
            pass
        time.sleep(SAMPLED_S)
    after = os.times()
    if process.returncode:
        raise SystemExit(f"o2train fleet ended with {process.returncode}")
    found = json.loads(out.with_suffix(".json").read_text())
    if (judged := found["drives"] - found["errors"]) < min(count, DISTINCT):  # the rest are copies
        raise SystemExit(f"{judged} recordings could be judged")
    return {
        "recordings": count,
        "wall_s": time.perf_counter() - began_s,
        "cpu_s": sum(after[2:4]) - sum(before[2:4]),
        "judging, ms each": 1e3 * sum(found["seconds"].values()) / count,
        "driving_h": found["driving_s"] / 3600.0,
        **{f"{name}_mb": value / 1e6 for name, value in peak.items()},
    }


def main(argv: Sequence[str]) -> int:
    """Judge folders of growing size."""
    options = BenchmarkOptions(__name__, __doc__, counts=[4], jobs=1)
    options.add_argument("--format", choices=("log", "blf", "parquet"), default="log")
    options.add_argument("--jobs", type=int, default=2)
    options.add_argument("--counts", type=int, nargs="+", default=[10, 100, 1000])
    args = options.parse_args(argv)
    rows: list[Row] = []
    with TemporaryDirectory(dir=os.environ.get("TMPDIR")) as temporary:
        root = Path(temporary)
        made = make(root / "made", args.format, max(args.counts))
        for count in args.counts:
            folder = link(made, root / str(count), count)
            rows.append(run(folder, root / f"{count}.parquet", args.jobs))
    return finish(args, rows)
