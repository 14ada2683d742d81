"""The live loop on a loaded bus: latency, processor share and lost frames.

One process sends a simulated drive in real time, filled up with unneeded frames. A second process
judges it, in turn with the project's loop and with a plain loop of python-can, cantools and
onnxruntime (no checks, no verdicts). The bus between them is struct can_frame over UDP on loopback,
see ``udp_can``. It carries 8,000 frames/s, and both loops read it with their SocketCAN code. The
sender runs on processor 0, the receiver on 1.

Latency: from the kernel's time stamp of the frame that closes a tick to the tick's event.
"""

import argparse
import json
import os
import struct
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.live.udp_can import Address, UdpCan
from benchmarks.repository import ROOT
from monitor.base import config
from monitor.base.types import Frame
from monitor.bus.loop import Loop
from monitor.bus.realtime import settle, use_cpu, use_priority
from monitor.decode.bus_map import load_database
from monitor.frames.logs import read_frames
from monitor.memory.dtc_store import DtcStore
from monitor.model.step import open_session
from monitor.pipeline import replay
from monitor.pipeline.events import Event, Tick
from monitor.pipeline.frames import FramePipeline

LOG = ROOT / "replay_logs" / "healthy_wltc_3b_v101_s101.blf"
START_S = 300.0  # of the drive: warm and under way
WARM_UP_S = 3.0  # at the begin of a run, not measured
LOADS = {"only needed frames": 0, "4,000 frames/s": 4000, "8,000 frames/s": 8000}
SIDES = ("project", "project, SCHED_FIFO", "plain loop")
PRIORITY = 50
N_WINDOW = 50
FILLER_ID = 0x600


@dataclass(frozen=True, slots=True)
class Figures:
    """What one run of one side gave."""

    side: str
    ticks: int
    p50_ms: float
    p99_ms: float
    worst_ms: float
    cpu_percent: float  # of one processor
    sent: int
    received: int


class Meter:
    """Collects latencies, and the processor time after the warm-up."""

    def __init__(self) -> None:
        self.latencies_ms: list[float] = []
        self._begin_s = time.monotonic() + WARM_UP_S
        self._from: tuple[float, float] | None = None

    def tick(self, t_ns: int) -> None:
        """Note that the tick closed by the frame stamped ``t_ns`` is done."""
        late_ns = time.time_ns() - t_ns
        if self._from is None:
            if time.monotonic() < self._begin_s:
                return
            self._from = time.monotonic(), time.process_time()
        self.latencies_ms.append(late_ns / 1e6)

    @property
    def cpu_percent(self) -> float:
        if self._from is None:
            raise SystemExit("nothing was received")
        wall_s, cpu_s = self._from
        return 100.0 * (time.process_time() - cpu_s) / (time.monotonic() - wall_s)


class Probe:
    """An attachment that meters the loop."""

    identifiers: tuple[tuple[int, bool], ...] = ()
    due_s = float("inf")

    def __init__(self, loop: Loop) -> None:
        self.meter, self._loop = Meter(), loop

    def receive(self, frame: Frame) -> tuple[Frame, ...]:
        return ()

    def push(self, event: Event) -> None:
        last_ns = self._loop._clock._last_ns
        if isinstance(event, Tick) and last_ns > event.sample.t_ns:  # else a time mark closed it
            self.meter.tick(last_ns)

    def work(self, now_s: float) -> tuple[Frame, ...]:
        return ()

    def close(self) -> None:
        pass


def judge_project(bus: UdpCan, seconds: float) -> tuple[Meter, int]:
    loop = Loop(bus, replay.set_up(None, (), config.load()))
    probe = Probe(loop)
    loop.attachments.append(probe)
    settle()
    ready(bus)
    loop.run(seconds)
    return probe.meter, loop.health.frames


def judge_plain(bus: UdpCan, seconds: float) -> tuple[Meter, int]:
    setup = replay.set_up(None, (), config.load())
    card, run = setup.model.card, open_session(setup.model_path.read_bytes(), "model").run
    database = load_database(setup.bus_map.pairs[0][0])
    mapped = {name: setup.bus_map.channels[name].mapped for name in card.input_names}
    inputs = [mapped[name].signal for name in card.input_names]
    output = setup.bus_map.channels[card.output.name].mapped.signal
    needed = {i for i, _ in _pipeline(setup).decoder.identifiers}
    values: dict[str, float] = {}
    state = np.zeros((1, card.state.size), np.float32)
    residuals: list[float] = []
    period_s, next_s, received = card.period_ns / 1e9, 0.0, 0
    n_needed = len({*inputs, output})
    ready(bus)
    meter, until_s = Meter(), time.monotonic() + seconds
    while time.monotonic() < until_s:
        message = bus.recv(0.1)
        if message is None:
            continue
        received += 1
        while message.timestamp >= next_s:
            next_s = next_s + period_s if next_s else message.timestamp + period_s
            if len(values) < n_needed:
                continue
            u = np.array([[values[name] for name in inputs]], np.float32)
            lambda_hat, state = run(["lambda_hat", "next_state"], {"u": u, "state": state})
            residuals.append(values[output] - float(lambda_hat[0, 0]))
            if len(residuals) == N_WINDOW:
                float(np.mean(residuals)), float(np.std(residuals))
                residuals.clear()
            meter.tick(round(message.timestamp * 1e9))
        if message.arbitration_id in needed:
            values.update(database.decode_message(message.arbitration_id, message.data))  # type: ignore[arg-type]
    return meter, received


def _pipeline(setup: replay.Setup) -> FramePipeline:
    return FramePipeline(setup.bus_map, setup.model, setup.limits, setup.config, DtcStore())


def ready(bus: UdpCan) -> None:
    print(json.dumps(bus.address), flush=True)


def receiver(side: str, seconds: float) -> None:
    """Judge what comes; the first line printed is the address, the second the figures."""
    use_cpu(1)
    if side == "project, SCHED_FIFO":
        use_priority(PRIORITY)
    with UdpCan() as bus:
        if side == "plain loop":
            bus.socket.setsockopt(1, 33, 8 << 20)  # so that it loses nothing either
        meter, received = (judge_plain if side == "plain loop" else judge_project)(bus, seconds)
        print(json.dumps([meter.latencies_ms, meter.cpu_percent, received]), flush=True)


def schedule(rate: int, seconds: float) -> list[tuple[float, bytes]]:
    """Return (time from the start, struct can_frame) of everything to send."""
    setup = replay.set_up(None, (), config.load())
    needed = set(_pipeline(setup).decoder.identifiers)
    due: list[tuple[float, bytes]] = []
    t0_ns: int | None = None
    for frame in read_frames(LOG):
        t0_ns = frame.t_ns if t0_ns is None else t0_ns
        t_s = (frame.t_ns - t0_ns) / 1e9 - START_S
        if t_s > seconds:
            break
        if t_s >= 0.0 and (rate or (frame.can_id, frame.is_extended) in needed):
            flag = 0x80000000 if frame.is_extended else 0
            data = frame.data.ljust(8, b"\0")
            due.append((t_s, struct.pack("=IB3x8s", frame.can_id | flag, len(frame.data), data)))
    n_filler = max(round(rate * seconds) - len(due), 0)
    filler = [struct.pack("=IB3x8x", FILLER_ID + k, 8) for k in range(64)]
    due += [(k * seconds / n_filler, filler[k % 64]) for k in range(n_filler)]
    return sorted(due, key=lambda item: item[0])


def send(address: Address, due: list[tuple[float, bytes]]) -> int:
    """Send everything at its time; return how many frames."""
    with UdpCan(peer=address) as bus:
        sendto, monotonic = bus.socket.sendto, time.monotonic
        start_s = monotonic()
        for t_s, frame in due:
            left_s = start_s + t_s - monotonic()
            if left_s > 0.0:
                time.sleep(left_s)
            sendto(frame, address)
    return len(due)


def measure(side: str, due: list[tuple[float, bytes]], seconds: float) -> Figures:
    command = [sys.executable, __file__, "--receiver", side, "--seconds", str(seconds + 1.0)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        address = json.loads(process.stdout.readline())
        sent = send(tuple(address), due)
        latencies, cpu_percent, received = json.loads(process.stdout.readline())
    p50, p99 = np.percentile(latencies, [50, 99])
    return Figures(
        side=side,
        ticks=len(latencies),
        p50_ms=float(p50),
        p99_ms=float(p99),
        worst_ms=max(latencies),
        cpu_percent=cpu_percent,
        sent=sent,
        received=received,
    )


def table(load: str, rows: list[Figures]) -> Iterator[str]:
    yield f"{load}: {rows[0].sent} frames sent"
    yield f"  {'':<22}{'ticks':>6}{'p50 ms':>9}{'p99 ms':>9}{'worst':>9}{'CPU %':>8}{'lost':>7}"
    for r in rows:
        yield (
            f"  {r.side:<22}{r.ticks:6d}{r.p50_ms:9.2f}{r.p99_ms:9.2f}{r.worst_ms:9.2f}"
            f"{r.cpu_percent:8.2f}{r.sent - r.received:7d}"
        )
    project, plain = rows[0], rows[-1]
    yield f"  share of the plain loop's CPU: {project.cpu_percent / plain.cpu_percent:.2f}"


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=30.0, help="of each run")
    parser.add_argument("--load", choices=LOADS, action="append", help="default: all")
    parser.add_argument("--json", type=Path, metavar="OUT")
    parser.add_argument("--receiver", choices=SIDES, help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    if args.receiver:
        receiver(args.receiver, args.seconds)
        return 0
    os.sched_setaffinity(0, {0})
    report: dict[str, Any] = {"schema": "o2bench.live_latency/1", "loads": {}}
    for load in args.load or LOADS:
        due = schedule(LOADS[load], args.seconds)
        rows = [measure(side, due, args.seconds) for side in SIDES]
        print("\n".join(table(load, rows)), flush=True)
        report["loads"][load] = [asdict(row) for row in rows]
    if args.json:
        args.json.write_text(json.dumps(report, indent=1) + "\n")
    return 0
