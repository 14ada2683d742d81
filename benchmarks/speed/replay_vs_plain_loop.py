"""``o2mon replay`` as a user calls it, beside a plain loop of python-can, cantools and onnxruntime.

The logs are synthetic candump text: half an hour of the project's own ECU, and a full bus of 500
kbit/s (4,000 frames/s). A replay is a process of its own: start-up, JSON and HTML are included.
"base" hides numba and asammdf from it, as if no extra were installed; both installations must write
the same bytes. The plain loop (``plain_loop.py``) reads the first minutes, decodes the needed
messages or all of the bus, and checks nothing. All take turns; figures are medians.

python -m benchmarks replay_vs_plain_loop [--seconds 2700] [--rounds 3]
"""

import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from statistics import median
from time import perf_counter

from benchmarks.measures import cpu_s
from benchmarks.outcome import BenchmarkOptions, Row, finish, say
from benchmarks.speed import traffic
from benchmarks.speed.plain_loop import PlainLoop
from monitor.base import config
from monitor.pipeline.replay import set_up
from training.recordings.files.can_log import write_log

TARGET = 50.0  # times as fast as the plain loop
OWN_S, PLAIN_S = 1800.0, 60.0
HIDDEN = {"base": ("numba", "asammdf"), "[fleet]": ()}
SCRIPT = """
import sys
sys.modules.update(dict.fromkeys({hidden!r}))
from monitor.cli import main
sys.exit(main({arguments!r}))
"""


def replayed(path: Path, hidden: tuple[str, ...], cache: str) -> tuple[float, float, bytes]:
    """Return seconds by the clock and of the processor, and what a replay wrote."""
    out = [path.with_suffix(suffix) for suffix in (".json", ".html")]
    arguments = ["replay", str(path), "--quiet", "--json", str(out[0]), "--html", str(out[1])]
    environment = os.environ | {"PYTHONPYCACHEPREFIX": cache}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), perf_counter()
    script = SCRIPT.format(hidden=hidden, arguments=arguments)
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, stdout=subprocess.DEVNULL, check=False
    )
    wall_s, after = perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode not in (0, 1):
        raise SystemExit(f"{path.name}: exit code {done.returncode}")
    took_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return wall_s, took_s, b"".join(each.read_bytes() for each in out)


def plain(part: Path, foreign: str) -> float:
    """Return the processor seconds of the plain loop."""
    loop = PlainLoop(set_up(None, (), config.load()), foreign)
    return cpu_s(lambda: loop.read(part))


def measure(path: Path, drive_s: float, rounds: int, folder: Path) -> list[Row]:
    """Return a row for each installation and each form of the plain loop."""
    part, part_s = folder / f"part_{path.name}", min(drive_s, PLAIN_S)
    n_lines = int(path.read_bytes().count(b"\n") * part_s / drive_s)
    with path.open("rb") as lines:
        part.write_bytes(b"".join(islice(lines, n_lines)))
    forms = {"needed messages": "", "all messages": traffic.foreign_dbc()}
    runs: dict[str, list[tuple[float, float]]] = {}
    written: set[bytes] = set()
    cache = str(folder / "cache") if rounds > 1 else ""  # compiled, as an installation has it
    for number in range(0 if rounds > 1 else 1, rounds + 1):  # the first of several compiles
        for name, hidden in HIDDEN.items():
            wall_s, took_s, content = replayed(path, hidden, cache)
            written.add(content)
            if number:
                runs.setdefault(name, []).append((drive_s / wall_s, drive_s / took_s))
        for form, foreign in forms.items() if number else ():
            times = part_s / plain(part, foreign)
            runs.setdefault(f"plain loop, {form}", []).append((times, times))
        say(f"{path.name}: round {number} of {rounds}")
    if len(written) != 1:
        raise SystemExit(f"{path.name}: the installations write different bytes")
    of = {name: [median(column) for column in zip(*r, strict=True)] for name, r in runs.items()}
    plain_times = of["plain loop, needed messages"][1]
    return [
        {
            "log": path.name,
            "mb": path.stat().st_size / 1e6,
            "drive_s": drive_s,
            "what": name,
            "x real time, clock": wall,
            "x real time, processor": cpu,
            "x plain loop": cpu / plain_times,
        }
        for name, (wall, cpu) in of.items()
    ]


def main(argv: Sequence[str]) -> int:
    """Compare on both logs; return 1 if the base is not 50 times as fast on the full bus."""
    options = BenchmarkOptions(__name__, __doc__, seconds=60.0, rounds=1)
    options.add_argument("--seconds", type=float, default=2700.0, help="of the full bus")
    options.add_argument("--rounds", type=int, default=3)
    args = options.parse_args(argv)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for log, frames, drive_s in (
            ("own.log", traffic.own(min(OWN_S, args.seconds)), min(OWN_S, args.seconds)),
            ("full_bus.log", traffic.full_bus(args.seconds), args.seconds),
        ):
            write_log(folder / log, frames)
            rows += measure(folder / log, drive_s, args.rounds, folder)
    full = {row["what"]: row["x plain loop"] for row in rows if row["log"] == "full_bus.log"}
    reached = float(full["base"] or 0.0)
    slow = f"{reached:.0f} times the plain loop, wanted {TARGET:g}"
    return finish(args, rows, [slow] * (not args.smallest and reached < TARGET))
