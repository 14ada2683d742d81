"""Days of bus time through the live loop at full speed: constant memory, no false code.

A healthy simulated drive is played again and again from memory. The loop has all attachments of a
service: fault memory on disk, transmitter, journal, status line. The bus is silent for a moment
between two drives. The drives are healthy, so every code is wrong.

python -m benchmarks soak [--hours 24] [--every 1]
"""

import gc
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from itertools import count
from pathlib import Path

import can

from benchmarks.live.played import SILENCE_S, Played
from benchmarks.measures import heap_kb, rss_mb
from benchmarks.outcome import BenchmarkOptions, Row, finish
from benchmarks.repository import REPLAY_LOGS
from monitor.base import config
from monitor.base.types import Frame
from monitor.bus.link.recorder import message_of
from monitor.bus.loop import Loop
from monitor.bus.terminal import Out, Screen
from monitor.bus.transmit import Transmitter
from monitor.frames.logs import read_frames
from monitor.memory.store import Memory
from monitor.pipeline import replay

LOG = REPLAY_LOGS / "healthy_wltc_3b_v101_s101.blf"
PAUSE_S = 2.0  # between two drives: time marks are made, no communication is lost yet
BEGIN_NS = 1_700_000_000_000_000_000


@dataclass(frozen=True, slots=True)
class SoakPoint:
    """What one stretch of bus time left behind."""

    bus_h: float
    rss_mb: float
    objects: int  # blocks of memory that Python's objects hold
    buffers_kb: float  # that the C library holds, among them those of arrays
    windows: int
    codes: tuple[str, ...]


def laps(drive: list[Frame], until_s: float) -> Iterator[can.Message | None]:
    """Yield a drive again and again; what a frame says is the same, its time goes on."""
    length_ns = drive[-1].t_ns - drive[0].t_ns + round(PAUSE_S * 1e9)
    for lap in count():
        shift_ns = BEGIN_NS + lap * length_ns - drive[0].t_ns
        for frame in drive:
            t_ns = frame.t_ns + shift_ns
            if t_ns - BEGIN_NS > until_s * 1e9:
                return
            yield message_of(frame._replace(t_ns=t_ns))
        yield from [None] * (round(PAUSE_S / SILENCE_S) - 1)


def soak(log: Path, hours: float, every_h: float, folder: Path) -> list[SoakPoint]:
    """Return a point after every so many hours of bus time."""
    bus = Played(laps(list(read_frames(log)), hours * 3600.0))
    points: list[SoakPoint] = []
    gc.freeze()  # what is loaded does not grow
    with closing(Memory(folder / "o2.db")) as memory, bus, Path(os.devnull).open("w") as nowhere:
        loop = bus.loop = Loop(
            bus,
            replay.set_up(None, (), config.load()),
            memory=memory,
            say=lambda line: print(line, file=sys.stderr),
            monotonic_s=lambda: bus.now_s,
        )
        monitor, out = loop.pipeline.monitor, Out(nowhere)
        loop.attachments += [
            Transmitter(monitor),
            Screen(monitor, loop.health, loop.collector, out),
        ]

        class Gauge(Screen):
            due_s = 0.0

            def work(self, now_s: float) -> tuple[Frame, ...]:
                if now_s >= self.due_s:
                    self.due_s = now_s + every_h * 3600.0
                    gc.collect()
                    held = sys.getallocatedblocks(), heap_kb()
                    codes = tuple(dtc.code for dtc in monitor.store.active)
                    points.append(SoakPoint(now_s / 3600.0, rss_mb(), *held, self._windows, codes))
                    print(json.dumps(asdict(points[-1])), file=sys.stderr)
                return ()

        loop.attachments.append(Gauge(monitor, loop.health, loop.collector, out))
        loop.run()
        if loop.health.detached or loop.health.memory_errors:
            raise SystemExit(f"not all went well: {loop.health}")
    return points


def main(argv: Sequence[str]) -> int:
    """Play drives; return 1 if a code came."""
    options = BenchmarkOptions(__name__, __doc__, hours=0.04, every=0.02)
    options.add_argument("--log", type=Path, default=LOG, help="a healthy drive")
    options.add_argument("--hours", type=float, default=24.0, help="of bus time")
    options.add_argument("--every", type=float, default=1.0, metavar="HOURS")
    args = options.parse_args(argv)
    start_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        points = soak(args.log, args.hours, args.every, Path(folder))
    times = args.hours * 3600.0 / (time.monotonic() - start_s)
    rows: list[Row] = [asdict(p) | {"codes": " ".join(p.codes)} for p in points]
    missed = [f"codes at {p.bus_h:.1f} h: {p.codes}" for p in points if p.codes]
    return finish(args, [*rows, {"times real time": times}], missed)
