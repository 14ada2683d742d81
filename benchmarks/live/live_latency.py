"""The live loop on a loaded bus: latency, processor share and lost frames.

One process sends a simulated drive in real time, filled up with unneeded frames. A second process
judges it, in turn with the project's loop and with a plain loop of python-can, cantools and
onnxruntime (no checks, no verdicts). The bus between them is struct can_frame over UDP on loopback,
see ``udp_can``; both read it with their SocketCAN code. The sender runs on processor 0, the
receiver on 1.

Latency: from the instant at which the frame that closes a tick was sent to the tick's event. The
receiver notes ticks and the time of their events, the sender when each frame was sent.

python -m benchmarks live_latency [--seconds 30] [--load RATE ...] [--record]
"""

import argparse
import gc
import json
import os
import struct
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from benchmarks.live.udp_can import Address, UdpCan
from benchmarks.measures import benchmark_call
from benchmarks.outcome import BenchmarkOptions, Row, finish, say
from benchmarks.repository import REPLAY_LOGS
from benchmarks.speed.plain_loop import PlainLoop
from monitor.base import config
from monitor.bus.attachment import Attachment
from monitor.bus.loop import Loop
from monitor.frames.logs import read_frames
from monitor.pipeline import replay
from monitor.pipeline.events import Event, Tick

LOG: Final = REPLAY_LOGS / "healthy_wltc_3b_v101_s101.blf"
START_S: Final = 300.0  # of the drive: warm and under way
WARM_UP_S: Final = 3.0  # at the begin of a run, not measured
LOADS: Final = (0, 4000, 8000)  # frames/s, 0: those that are needed, alone
PROJECT, FIFO, PLAIN = SIDES = ("project", "project, SCHED_FIFO", "plain loop")
PRIORITY: Final = 50
FILLER_ID: Final = 0x600
SO_RCVBUFFORCE: Final = 33


class Meter:
    """Notes ticks and the time of their events, and the processor time after the warm-up."""

    def __init__(self, warm_up_s: float) -> None:
        self.events: list[tuple[int, int]] = []  # time of a tick, and of its event, ns
        self._begin_s = time.monotonic() + warm_up_s
        self._from: tuple[float, float] | None = None

    def tick(self, t_ns: int) -> None:
        """Note that the tick at ``t_ns`` is done."""
        now_ns = time.time_ns()
        if self._from is None:
            if time.monotonic() < self._begin_s:
                return
            self._from = time.monotonic(), time.process_time()
        self.events.append((t_ns, now_ns))

    @property
    def cpu_percent(self) -> float:
        """Return the share of one processor since the warm-up."""
        if self._from is None:
            raise SystemExit("live_latency: nothing was received")
        wall_s, cpu_s = self._from
        return 100.0 * (time.process_time() - cpu_s) / (time.monotonic() - wall_s)


class Probe(Attachment):
    """An attachment that meters the loop."""

    def __init__(self, meter: Meter) -> None:
        self._meter = meter

    def push(self, event: Event) -> None:
        if isinstance(event, Tick):
            self._meter.tick(event.sample.t_ns)


def receiver(side: str, seconds: float, warm_up_s: float, *, record: bool) -> None:
    """Judge what comes; the first line printed is the address, the second what was met."""
    os.sched_setaffinity(0, {1})
    if side == FIFO:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    setup, meter = replay.set_up(None, (), config.load()), Meter(warm_up_s)
    with UdpCan() as bus, tempfile.TemporaryDirectory() as folder:
        if side == PLAIN:
            received = _plain(bus, PlainLoop(setup), meter, seconds)
        else:
            log = Path(folder) / "live.log" if record else None
            loop = Loop(bus, setup, attachments=[Probe(meter)], record=log, say=say)
            gc.collect()
            gc.freeze()
            _ready(bus)
            loop.run(seconds)
            received = loop.health.frames
    print(json.dumps([meter.events, meter.cpu_percent, received]), flush=True)


def _plain(bus: UdpCan, loop: PlainLoop, meter: Meter, seconds: float) -> int:
    """Judge with the plain loop; return the number of frames."""
    bus.socket.setsockopt(1, SO_RCVBUFFORCE, 8 << 20)  # so that it loses nothing either
    _ready(bus)
    received, until_s = 0, time.monotonic() + seconds
    while time.monotonic() < until_s:
        message = bus.recv(0.1)
        if message is not None:
            received += 1
            for tick_s in loop.push(message):
                meter.tick(round(tick_s * 1e9))
    return received


def _ready(bus: UdpCan) -> None:
    print(json.dumps(bus.address), flush=True)


class Due(NamedTuple):
    """One frame to send."""

    t_s: float  # from the start
    frame: bytes  # struct can_frame


def schedule(rate: int, seconds: float) -> list[Due]:
    """Return everything to send."""
    setup = replay.set_up(None, (), config.load())
    needed = PlainLoop(setup).needed
    due: list[Due] = []
    t0_ns: int | None = None
    for frame in read_frames(LOG):
        t0_ns = frame.t_ns if t0_ns is None else t0_ns
        t_s = (frame.t_ns - t0_ns) / 1e9 - START_S
        if t_s > seconds:
            break
        if t_s >= 0.0 and (rate or frame.can_id in needed):
            identifier = frame.can_id | (0x80000000 if frame.is_extended else 0)
            data = frame.data.ljust(8, b"\0")
            due.append(Due(t_s, struct.pack("=IB3x8s", identifier, len(frame.data), data)))
    n_filler = max(round(rate * seconds) - len(due), 0)
    filler = [struct.pack("=IB3x8x", FILLER_ID + k, 8) for k in range(64)]
    due += [Due(k * seconds / n_filler, filler[k % 64]) for k in range(n_filler)]
    return sorted(due, key=lambda each: each.t_s)


def send(address: Address, due: Sequence[Due]) -> list[int]:
    """Send everything at its time; return when each was sent, ns."""
    sent: list[int] = []
    with UdpCan(peer=address) as bus:
        sendto: Callable[[bytes, Address], int] = bus.socket.sendto
        start_s = time.monotonic()
        for t_s, frame in due:
            left_s = start_s + t_s - time.monotonic()
            if left_s > 0.0:
                time.sleep(left_s)
            sent.append(time.time_ns())
            sendto(frame, address)
    return sent


def measure(side: str, due: Sequence[Due], args: argparse.Namespace) -> Row:
    """Return what one run of one side gave."""
    warm_up_s = min(WARM_UP_S, args.seconds / 3.0)
    options = ["--seconds", args.seconds + 1.0, "--warm-up", warm_up_s]
    command = benchmark_call(
        "live_latency", "--receiver", side, *options, *["--record"] * args.record
    )
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        address = json.loads(process.stdout.readline() or "null")
        if address is None:
            raise SystemExit(f"live_latency: the receiver of {side} did not start")
        sent_ns = np.array(send(tuple(address), due))
        told = json.loads(process.stdout.readline() or "null")
    if not told or not told[0]:
        raise SystemExit(f"live_latency: {side} received nothing")
    events, cpu_percent, received = told
    tick_ns, event_ns = np.array(events).T
    closing = np.searchsorted(sent_ns, tick_ns)
    closed = closing < len(sent_ns)  # behind the last frame a time mark closes the tick
    late_ms = (event_ns[closed] - sent_ns[closing[closed]]) / 1e6
    return {
        "side": side,
        "frames": len(due),
        "ticks": len(late_ms),
        "p50_ms": float(np.percentile(late_ms, 50)),
        "p99_ms": float(np.percentile(late_ms, 99)),
        "worst_ms": float(late_ms.max()),
        "cpu_percent": cpu_percent,
        "lost": len(due) - received,
    }


def main(argv: Sequence[str]) -> int:
    """Measure each side under each load."""
    options = BenchmarkOptions(__name__, __doc__, seconds=1.0, load=[4000], sides=[PROJECT, PLAIN])
    options.add_argument("--seconds", type=float, default=30.0, help="of each run")
    options.add_argument("--load", type=int, nargs="+", default=LOADS, help="frames/s")
    options.add_argument("--sides", nargs="+", choices=SIDES, default=SIDES)
    options.add_argument("--record", action="store_true", help="the project records as well")
    options.add_argument("--receiver", choices=SIDES, help=argparse.SUPPRESS)
    options.add_argument("--warm-up", type=float, help=argparse.SUPPRESS)
    args = options.parse_args(argv)
    if args.receiver:
        receiver(args.receiver, args.seconds, args.warm_up, record=args.record)
        return 0
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {0})
    rows: list[Row] = []
    try:
        for load in args.load:
            due = schedule(load, args.seconds)
            rows += [{"load": load} | dict(measure(side, due, args)) for side in args.sides]
    finally:
        os.sched_setaffinity(0, before)
    return finish(args, rows)
