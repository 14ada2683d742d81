"""``o2mon replay`` as a user calls it: by the clock, with start-up, JSON and HTML included.

Each run is a process of its own. "base" hides numba and asammdf from it, as if no extra were
installed; "[fleet]" has them. The logs are synthetic: an hour of the project's own ECU, and a full
bus of 500 kbit/s (see ``fleet_log.py``). The plain loop of ``replay_vs_plain_loop.py`` reads the
first minutes of the full bus and checks nothing. Figures are the smallest of the repeats; both
installations take turns and must write the same bytes.

    python -m benchmarks replay_clock [--seconds 2700] [--repeats 3]
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from time import perf_counter

from benchmarks.speed.fleet_log import experiment, loaded
from benchmarks.speed.replay_vs_plain_loop import Bench, replay_plain
from monitor.base import config
from monitor.decode.bus_map import load_database
from monitor.pipeline.replay import set_up
from training.dyno.recording_files import write
from training.recordings.can_log import write_log

DRIVE_S, PLAIN_S = 1800, 60.0
HIDDEN = {"base": ("numba", "asammdf"), "[fleet]": ()}
SCRIPT = """
import sys
sys.modules.update(dict.fromkeys({hidden!r}))
from monitor.cli import main
sys.exit(main({arguments!r}))
"""


def own_hour(folder: Path) -> Path:
    """Return a log of two drives of half an hour, one after the other."""
    once = write(experiment(0, DRIVE_S), folder, "log")
    path = folder / "own_hour.log"
    lines = once.read_bytes().splitlines(keepends=True)
    with path.open("wb") as file:
        for shift_s in (0, DRIVE_S):
            for line in lines:
                seconds, rest = line[1:].split(b".", 1)
                file.write(b"(%d.%s" % (int(seconds) + shift_s, rest))
    return path


def full_bus(folder: Path, seconds: float) -> Path:
    """Return a log of a full bus, drives of half an hour one after the other."""
    path, frames = folder / "full_bus.log", loaded(min(seconds, DRIVE_S))
    write_log(path, frames)
    if seconds > DRIVE_S:
        with path.open("ab") as file, path.open("rb") as source:
            for line in islice(source, int(len(frames.t_ns) * (seconds / DRIVE_S - 1.0))):
                begin, rest = line[1:].split(b".", 1)
                file.write(b"(%d.%s" % (int(begin) + DRIVE_S, rest))
    return path


def clocked(path: Path, hidden: tuple[str, ...], cache: Path) -> tuple[float, float, bytes]:
    """Return seconds by the clock and of the processor, and what a replay wrote."""
    out = [path.with_suffix(suffix) for suffix in (".json", ".html")]
    arguments = ["replay", str(path), "--quiet", "--json", str(out[0]), "--html", str(out[1])]
    environment = os.environ | {"PYTHONPYCACHEPREFIX": str(cache)}  # as an installation has them
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), perf_counter()
    script = SCRIPT.format(hidden=hidden, arguments=arguments)
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, stdout=subprocess.DEVNULL, check=False
    )
    wall_s, after = perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode not in (0, 1):
        raise SystemExit(f"{path.name}: exit code {done.returncode}")
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return wall_s, cpu_s, b"".join(each.read_bytes() for each in out)


def measure(path: Path, drive_s: float, repeats: int, cache: Path) -> None:
    """Print what a replay takes with each installation."""
    best = dict.fromkeys(HIDDEN, (float("inf"), float("inf")))
    written: set[bytes] = set()
    for number in range(repeats + 1):  # the first compiles
        for name, hidden in HIDDEN.items():
            wall_s, cpu_s, content = clocked(path, hidden, cache)
            written.add(content)
            if number:
                best[name] = min(best[name][0], wall_s), min(best[name][1], cpu_s)
    if len(written) != 1:
        raise SystemExit(f"{path.name}: the installations write different bytes")
    print(f"{path.name}, {path.stat().st_size / 1e6:.0f} MB, {drive_s:.0f} s (synthetic)")
    for name, (wall_s, cpu_s) in best.items():
        print(
            f"  {name:10}{wall_s:7.2f} s by the clock, {drive_s / wall_s:6.0f} x real time; "
            f"{cpu_s:6.2f} s of the processor, {drive_s / cpu_s:6.0f} x",
            flush=True,
        )


def plain(path: Path, folder: Path) -> None:
    """Print what the plain loop takes."""
    part = folder / "part.log"
    part.write_bytes(b"".join(islice(path.open("rb"), int(PLAIN_S * 4000))))
    setup = set_up(None, (), config.load())
    database = load_database(setup.bus_map.pairs[0][0])
    (seconds,) = replay_plain(Bench(part, setup, database, [], []))
    print(f"  plain loop {PLAIN_S / seconds:5.0f} x real time, needed messages, no checks")


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=2700.0, help="of the full bus")
    parser.add_argument("--repeats", type=int, default=3)
    args = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        measure(own_hour(folder), 2.0 * DRIVE_S, args.repeats, folder / "cache")
        path = full_bus(folder, args.seconds)
        measure(path, args.seconds, args.repeats, folder / "cache")
        plain(path, folder)
    return 0
